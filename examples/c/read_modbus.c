/* Reads x, y, yaw and pitch of a laser target over Modbus TCP; docs/clients.md has the rules.
   cc -std=c99 read_modbus.c -lmodbus -o read_modbus; read_modbus ADDRESS PORT SERIAL LIMIT_MS [--rehearsal] */
#define _POSIX_C_SOURCE 199309L
#include <modbus/modbus.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
static const char *const REASONS[30] = {[1] = "spot_missing", "ambiguous", "saturated", "cut_by_edge", "wrong_size",
    "wrong_shape", "camera_silent", "implausible", "exposure_changing", "distorted", "frame_repeated", "wrong_camera",
    [20] = "out_of_step", "out_of_range", "unsteady", "warming_up", "stale", "check_failed", "geometry_drift",
    "geometry_unverified", "self_checking", "not_live"};
struct target { /* times are ms of a clock that is never set; begin with unit, limit_ms, rehearsal and zeros */
    uint32_t unit, session, message, clock_ms, published;
    double limit_ms, delay_ms, heard_ms, changed_ms, until_ms;
    int rehearsal, usable;
    const char *refusal; /* "restarted" or "silent", until it is acknowledged */
    float values[4]; /* x, y in mm, yaw, pitch in degrees; only while usable */
};
static uint32_t crc32(uint32_t crc, uint32_t byte) { /* begin with 0 */
    crc = ~crc ^ byte;
    for (int bit = 0; bit < 8; bit++) crc = (crc >> 1) ^ (crc & 1 ? 0xEDB88320u : 0);
    return ~crc;
}
static uint32_t u32(const uint16_t *at) { return (uint32_t)at[0] << 16 | at[1]; }
static const char *update(struct target *t, const uint16_t *r, double now_ms, int acknowledged) {
    static char invalid[60];
    if (now_ms >= t->until_ms) t->usable = 0;
    if (!r) return "no answer";
    uint32_t crc = 0;
    for (int i = 0; i < 78; i++) crc = crc32(crc32(crc, r[i] >> 8), r[i] & 0xFF);
    if (crc != u32(r + 78) || r[0] != 1) return "corrupt";
    if (u32(r + 2) != t->unit || t->unit == 0) return "foreign";
    if (u32(r + 4) != t->session)
        t->refusal = t->session ? "restarted" : NULL, t->session = u32(r + 4), t->message = u32(r + 6) - 1,
        t->clock_ms = u32(r + 8), t->heard_ms = t->changed_ms = now_ms, t->delay_ms = acknowledged = 0;
    uint32_t newer = u32(r + 6) - t->message, unit_ms = u32(r + 8) - t->clock_ms, age_ms = u32(r + 18);
    if (newer == 0 || newer >= 0x80000000u) return "not newer";
    double silent_ms = now_ms - t->heard_ms;
    if (silent_ms > t->limit_ms || acknowledged) t->refusal = silent_ms > t->limit_ms ? "silent" : NULL;
    t->delay_ms += silent_ms * 0.9998 - unit_ms; if (t->delay_ms < 0) t->delay_ms = 0;
    if (u32(r + 10) != t->published) t->changed_ms = now_ms;
    t->message = u32(r + 6), t->clock_ms = u32(r + 8), t->published = u32(r + 10), t->heard_ms = now_ms;
    if (!t->refusal && age_ms != 0xFFFFFFFFu && age_ms + t->delay_ms > t->limit_ms) return "late";
    t->usable = 0; /* the faults above keep the last values until their time is over */
    if (t->refusal || now_ms - t->changed_ms > t->limit_ms) return t->refusal ? t->refusal : "stopped";
    if ((r[20] & 0x3000) && !t->rehearsal) return "not live";
    int good = (r[20] & 1) && age_ms != 0xFFFFFFFFu, code = r[22] ? r[22] : r[23] ? r[23] : r[21];
    for (int i = 0; i < 4; i++) t->values[i] = modbus_get_float_abcd(r + 30 + 2 * i);
    for (int i = 0; i < 4; i++) good = good && t->values[i] > -1e6f && t->values[i] < 1e6f; /* NaN is neither */
    if (!good) {
        const char *of = r[22] ? "front_" : r[23] ? "rear_" : "";
        const char *word = code < 30 && REASONS[code] ? REASONS[code] : "unknown_reason";
        return snprintf(invalid, sizeof invalid, "not valid: %s%s", of, word), invalid;
    }
    t->usable = 1, t->until_ms = now_ms + t->limit_ms - age_ms - t->delay_ms;
    return "good";
}
int main(int argc, char **argv) {
    if (argc < 5) return fputs("read_modbus ADDRESS PORT SERIAL LIMIT_MS [--rehearsal]\n", stderr), 2;
    struct target t = {.limit_ms = 0.75 * atof(argv[4]), .rehearsal = argc > 5 && !strcmp(argv[5], "--rehearsal")};
    for (const char *c = argv[3]; *c; c++) t.unit = crc32(t.unit, (uint8_t)*c);
    modbus_t *unit = modbus_new_tcp(argv[1], atoi(argv[2]));
    modbus_set_response_timeout(unit, atoi(argv[4]) / 20000, atoi(argv[4]) % 20000 * 50); /* LIMIT_MS / 20 */
    modbus_set_byte_timeout(unit, 0, 0); /* the whole answer has to come in that time */
    sigset_t pressed; /* the signal SIGUSR1 acknowledges a unit that was restarted or silent */
    sigemptyset(&pressed), sigaddset(&pressed, SIGUSR1), sigprocmask(SIG_BLOCK, &pressed, NULL);
    struct timespec now, pause = {0, 50000000}; uint16_t r[80]; const float *v = t.values;
    for (int connected = 0, acknowledged = 0;; acknowledged = sigtimedwait(&pressed, NULL, &pause) == SIGUSR1) {
        connected = connected || modbus_connect(unit) == 0;
        connected = connected && modbus_read_input_registers(unit, 200, 80, r) == 80;
        if (!connected) modbus_close(unit); /* an answer that comes later must not be taken for the next one */
        clock_gettime(CLOCK_MONOTONIC, &now);
        const char *fault = update(&t, connected ? r : NULL, now.tv_sec * 1e3 + now.tv_nsec / 1e6, acknowledged);
        if (t.usable) printf("x %.4f mm, y %.4f mm, yaw %.4f deg, pitch %.4f deg", v[0], v[1], v[2], v[3]);
        printf("%s (%s)\n", t.usable ? "" : "no value", fault), fflush(stdout);
    }
}
