/* Runs altd_telegram.c for the tests. Standard input: "N MAX_AGE_MS SERIAL" begins (no serial: unchecked),
 * "F NOW_MS HEX" feeds, "R" restarts, "E" ends a case. Answers with a line a reading, and "= DAMAGED LOST". */
#include "altd_telegram.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void number(double value)
{
    if (isnan(value))
        printf(" -");
    else
        printf(" %.17g", value);
}

static void count(int64_t value)
{
    if (value == -1)
        printf(" -");
    else
        printf(" %" PRId64, value);
}

static void show(const struct altd_reading *r)
{
    const double numbers[] = {r->x_mm, r->y_mm, r->yaw_deg, r->pitch_deg, r->roll_deg,
                              r->sigma_x_mm, r->sigma_y_mm, r->sigma_yaw_deg, r->sigma_pitch_deg,
                              r->sigma_now_x_mm, r->sigma_now_y_mm, r->sigma_now_yaw_deg, r->sigma_now_pitch_deg};
    const int64_t counts[] = {r->sequence, r->frames, r->session, r->message, r->clock_ms, r->date, r->age_ms};
    printf("%d %d %c %s %s", r->valid, (int)r->fault, r->mode, *r->time ? r->time : "-",
           *r->reasons ? r->reasons : "-");
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++)
        number(numbers[i]);
    for (size_t i = 0; i < sizeof counts / sizeof *counts; i++)
        count(counts[i]);
    printf("\n");
}

int main(void)
{
    static char line[1 << 20];
    static struct altd_telegram telegram;
    struct altd_reading reading;
    unsigned long now_ms;
    int place;
    while (fgets(line, sizeof line, stdin)) {
        line[strcspn(line, "\n")] = '\0';
        if (sscanf(line, "N %lu %n", &now_ms, &place) == 1) {
            altd_telegram_begin(&telegram, line[place] ? line + place : NULL, (uint32_t)now_ms);
        } else if (sscanf(line, "F %lu %n", &now_ms, &place) == 1) {
            for (const char *at = line + place; *at; at += 2) {
                const char digits[] = {at[0], at[1], '\0'};
                unsigned char byte = (unsigned char)strtoul(digits, NULL, 16);
                if (altd_telegram_feed(&telegram, byte, (uint32_t)now_ms, &reading))
                    show(&reading);
            }
        } else if (*line == 'R') {
            altd_telegram_restart(&telegram);
        } else {
            printf("= %" PRIu32 " %" PRIu32 "\n", telegram.damaged, telegram.lost);
            fflush(stdout);
        }
    }
    return 0;
}
