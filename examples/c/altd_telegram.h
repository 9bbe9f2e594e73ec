/* Reads the serial telegram of an Active Laser Target (docs/telegram.md), in C99.
 *
 * No allocation and no globals: the whole state is one struct altd_telegram. Give it every byte of the line:
 *
 *     altd_telegram_begin(&telegram, "ALT-0007", 1000);
 *     ...
 *     if (altd_telegram_feed(&telegram, byte, now_ms, &reading) && reading.valid)
 *         steer(reading.x_mm, reading.y_mm, reading.yaw_deg, reading.pitch_deg);
 *
 * A silent line gives no reading: the program needs a time-out of its own. Begin with an empty receive
 * buffer, because an old telegram that waited there looks fresh.
 */
#ifndef ALTD_TELEGRAM_H
#define ALTD_TELEGRAM_H

#include <stddef.h>
#include <stdint.h>

/* Why a reading is refused; Reading.fault of altd_telegram.py in Python. */
enum altd_fault {
    ALTD_NO_FAULT,
    ALTD_FOREIGN,   /* of another unit */
    ALTD_RESTARTED, /* of another session: see altd_telegram_restart */
    ALTD_NOT_NEWER, /* repeated, or older than the one before */
    ALTD_LATE,      /* older than max_age_ms */
    ALTD_UNCHECKED  /* without the third sentence */
};

/* One telegram. A number that is not known is NAN or -1; with a fault the numbers of the beam are NAN. */
struct altd_reading {
    int valid;             /* use the numbers when this is 1, and only then */
    enum altd_fault fault;
    char mode;             /* 'A' live, 'V' invalid; 'P' (played) and 'S' (simulated) are never valid */
    int64_t sequence;      /* number of the last exposure */
    char time[11];         /* UTC, hhmmss.sss, middle of the averaged exposures */
    double x_mm, y_mm, yaw_deg, pitch_deg, roll_deg;
    double sigma_x_mm, sigma_y_mm, sigma_yaw_deg, sigma_pitch_deg;
    double sigma_now_x_mm, sigma_now_y_mm, sigma_now_yaw_deg, sigma_now_pitch_deg; /* at sending; if sent */
    int64_t frames;        /* exposures that were averaged */
    char reasons[80];      /* codes joined by '+': why it is invalid, or what it warns of */
    int64_t session, message, clock_ms; /* of the third sentence, like those below */
    int64_t date;          /* UTC, yyyymmdd */
    int64_t age_ms;        /* from the middle of the exposures to the moment when the unit sent it */
};

/* The state of one line; read damaged and lost, leave the rest alone. */
struct altd_telegram {
    uint32_t damaged;      /* lines that were no intact sentence, telegrams that lacked a sentence */
    uint32_t lost;         /* telegrams that were sent and not received; only with a serial number */

    int is_checked;
    uint32_t unit;
    double max_age_ms;
    char line[83];
    size_t used;
    int is_dirty;
    int sentences, is_consistent, is_foreign;
    uint32_t crc;
    struct altd_reading begun;
    int64_t sequence, session, message, clock_ms;
    uint32_t received_ms;
    double delay_ms;
};

/* Begin. serial: the unit's serial number in UTF-8; its port must have checked = true. NULL: the third
 * sentence is ignored, and other units, restarts and delays are not found; enough for a display and not for a
 * control. max_age_ms: age of the oldest valid measurement, with the delays that are found. */
void altd_telegram_begin(struct altd_telegram *telegram, const char *serial, uint32_t max_age_ms);

/* Accept the next telegram as the first one. Until this is called, a unit that was restarted is refused: an
 * old session that was recorded and is played again looks the same. Call it from the start procedure of the
 * machine. */
void altd_telegram_restart(struct altd_telegram *telegram);

/* Take one byte. Returns 1 when it completes a reading. now_ms: a clock that is never set; it may wrap. */
int altd_telegram_feed(struct altd_telegram *telegram, unsigned char byte, uint32_t now_ms,
                       struct altd_reading *reading);

#endif
