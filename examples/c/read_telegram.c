/* Shows by what a machine may be steered: read_telegram DEVICE SERIAL_NUMBER [BAUD]. See docs/telegram.md. */
#define _DEFAULT_SOURCE
#include "altd_telegram.h"

#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

enum { MAX_AGE_MS = 1000, TIMEOUT_MS = 3000 }; /* an age of 500 to 600 ms is normal; three times interval_s */

static const char *const faults[] = {"", "of another unit", "the unit was restarted: start this program again",
    "not newer", "late", "without the third sentence"};

static uint32_t now_ms(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint32_t)now.tv_sec * 1000u + (uint32_t)(now.tv_nsec / 1000000);
}

static int open_port(const char *device, const char *baud)
{
    static const struct { long baud; speed_t speed; } speeds[] = {{9600, B9600}, {19200, B19200},
        {38400, B38400}, {57600, B57600}, {115200, B115200}, {230400, B230400}};
    struct termios line;
    int port = open(device, O_RDWR | O_NOCTTY | O_NONBLOCK);
    if (port < 0 || fcntl(port, F_SETFL, 0) != 0 || tcgetattr(port, &line) != 0)
        return -1;
    cfmakeraw(&line);
    line.c_cflag |= CLOCAL | CREAD;
    for (size_t i = 0; i < sizeof speeds / sizeof *speeds; i++)
        if (speeds[i].baud == strtol(baud, NULL, 10) && cfsetspeed(&line, speeds[i].speed) == 0)
            return tcsetattr(port, TCSANOW, &line) == 0 && tcflush(port, TCIFLUSH) == 0 ? port : -1;
    return -1;
}

static void use(const struct altd_reading *r)
{
    if (r->valid)
        printf("x %.3f mm, y %.3f mm, yaw %.4f deg, pitch %.4f deg, %.2f s old\n", r->x_mm, r->y_mm,
               r->yaw_deg, r->pitch_deg, (double)r->age_ms / 1000);
    else if (r->fault)
        printf("%s: %s\n", r->fault == ALTD_RESTARTED ? "STOP" : "refused", faults[r->fault]);
    else if (r->mode == 'V')
        printf("STOP: the unit says %s\n", r->reasons);
    else /* 'P' and 'S' */
        printf("STOP: not live, but played or simulated\n");
}

int main(int count, char **arguments)
{
    struct altd_telegram telegram;
    struct altd_reading reading;
    struct pollfd port = {.events = POLLIN};
    uint32_t valid_ms = now_ms();
    unsigned char bytes[256];
    if (count < 3 || (port.fd = open_port(arguments[1], count > 3 ? arguments[3] : "9600")) < 0)
        return fprintf(stderr, "usage: read_telegram DEVICE SERIAL_NUMBER [BAUD]\n"), 2;
    setvbuf(stdout, NULL, _IOLBF, BUFSIZ);
    altd_telegram_begin(&telegram, arguments[2], MAX_AGE_MS);
    for (;;) {
        ssize_t length = 0;
        if (poll(&port, 1, 100) > 0 && (length = read(port.fd, bytes, sizeof bytes)) <= 0)
            return printf("STOP: the port is gone\n"), 1;
        for (ssize_t i = 0; i < length; i++)
            if (altd_telegram_feed(&telegram, bytes[i], now_ms(), &reading)) {
                use(&reading);
                valid_ms = reading.valid ? now_ms() : valid_ms;
            }
        if (now_ms() - valid_ms > TIMEOUT_MS) {
            printf("STOP: no valid telegram for %d s\n", TIMEOUT_MS / 1000);
            valid_ms = now_ms();
        }
    }
}
