/* See altd_telegram.h. */
#include "altd_telegram.h"

#include <math.h>
#include <string.h>

#define MAX_SENTENCE 82u
#define MODULUS 0xFFFFFFFFu     /* of message and clock_ms: 0xFFFFFFFE is followed by 0 */
#define CLOCK_TOLERANCE 0.0002  /* share of the elapsed time by which two clocks may differ */
#define UNKNOWN (-1)

static const struct altd_reading nothing = {
    0, ALTD_NO_FAULT, 'V', UNKNOWN, "", NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN,
    NAN, NAN, NAN, NAN, UNKNOWN, "", UNKNOWN, UNKNOWN, UNKNOWN, UNKNOWN, UNKNOWN};

/* CRC-32 of IEEE 802.3, continued from the CRC of what came before; 0 at first. */
static uint32_t crc32_of(uint32_t crc, const char *data, size_t length)
{
    crc = ~crc;
    while (length--) {
        crc ^= (unsigned char)*data++;
        for (int bit = 0; bit < 8; bit++)
            crc = (crc >> 1) ^ (crc & 1u ? 0xEDB88320u : 0u);
    }
    return ~crc;
}

/* Fields: each function takes the next one and returns 0 when it has not the form that it must have. */

struct fields {
    const char *next, *end; /* next is NULL behind the last field */
};

struct field {
    const char *text;
    size_t length;
};

static int take(struct fields *fields, struct field *field)
{
    const char *comma;
    if (!fields->next)
        return 0;
    field->text = fields->next;
    comma = memchr(fields->next, ',', (size_t)(fields->end - fields->next));
    field->length = (size_t)((comma ? comma : fields->end) - fields->next);
    fields->next = comma ? comma + 1 : NULL;
    return 1;
}

static int digits(const char *text, size_t length, int64_t *value)
{
    int64_t sum = 0;
    if (length == 0 || length > 10)
        return 0;
    for (size_t i = 0; i < length; i++) {
        if (text[i] < '0' || text[i] > '9')
            return 0;
        sum = 10 * sum + (text[i] - '0');
    }
    *value = sum;
    return 1;
}

static int take_count(struct fields *fields, int64_t largest, size_t longest, int64_t *value)
{
    struct field field;
    if (!take(fields, &field))
        return 0;
    *value = UNKNOWN;
    if (field.length == 0)
        return 1;
    return field.length <= longest && digits(field.text, field.length, value) && *value <= largest;
}

static int take_number(struct fields *fields, int is_signed, size_t longest, size_t decimals, double *value)
{
    struct field field;
    int64_t whole, part, scale = 1;
    int is_negative;
    if (!take(fields, &field))
        return 0;
    *value = NAN;
    if (field.length == 0)
        return 1;
    is_negative = is_signed && field.text[0] == '-';
    if (is_negative) {
        field.text++;
        field.length--;
    }
    if (field.length < decimals + 2 || field.length > longest + decimals + 1
        || field.text[field.length - decimals - 1] != '.'
        || !digits(field.text, field.length - decimals - 1, &whole)
        || !digits(field.text + field.length - decimals, decimals, &part))
        return 0;
    for (size_t i = 0; i < decimals; i++)
        scale *= 10;
    *value = (double)(whole * scale + part) / (double)scale;
    if (is_negative)
        *value = -*value;
    return 1;
}

static int take_hexadecimal(struct fields *fields, int64_t *value)
{
    static const char hexadecimal[] = "0123456789ABCDEF";
    struct field field;
    if (!take(fields, &field) || field.length != 8)
        return 0;
    *value = 0;
    for (size_t i = 0; i < 8; i++) {
        const char *digit = memchr(hexadecimal, field.text[i], 16);
        if (!digit)
            return 0;
        *value = *value << 4 | (digit - hexadecimal);
    }
    return 1;
}

static int take_date(struct fields *fields, int64_t *value)
{
    static const int64_t longest[] = {31, 29, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31};
    struct field field;
    int64_t year, month, day;
    if (!take(fields, &field))
        return 0;
    *value = UNKNOWN;
    if (field.length == 0)
        return 1;
    if (field.length != 8 || !digits(field.text, 8, value))
        return 0;
    year = *value / 10000, month = *value / 100 % 100, day = *value % 100;
    if (year < 1 || month < 1 || month > 12 || day < 1 || day > longest[month - 1])
        return 0;
    return month != 2 || day < 29 || (year % 4 == 0 && (year % 100 != 0 || year % 400 == 0));
}

static int take_time(struct fields *fields, char time[11])
{
    struct field field;
    int64_t seconds, part;
    if (!take(fields, &field) || (field.length != 0 && field.length != 10))
        return 0;
    memcpy(time, field.text, field.length);
    time[field.length] = '\0';
    return field.length == 0
        || (time[6] == '.' && digits(time, 6, &seconds) && digits(time + 7, 3, &part)
            && seconds / 10000 < 24 && seconds / 100 % 100 < 60 && seconds % 100 < 60);
}

static int take_reasons(struct fields *fields, char reasons[80])
{
    struct field field;
    if (!take(fields, &field) || field.length > 79)
        return 0;
    memcpy(reasons, field.text, field.length);
    reasons[field.length] = '\0';
    for (size_t i = 0; i < field.length; i++) {
        char sign = reasons[i];
        int is_end = i == 0 || i + 1 == field.length || reasons[i - 1] == '+';
        if (!((sign >= 'a' && sign <= 'z') || (sign >= '0' && sign <= '9') || sign == '_'
              || (sign == '+' && !is_end)))
            return 0;
    }
    return 1;
}

static int has_reason(const char *reasons, const char *code)
{
    size_t length = strlen(code);
    const char *at = reasons;
    while ((at = strstr(at, code)) != NULL) {
        if ((at == reasons || at[-1] == '+') && (at[length] == '\0' || at[length] == '+'))
            return 1;
        at += length;
    }
    return 0;
}

/* Sentences */

static int read_measurement(struct fields *fields, struct altd_reading *reading)
{
    struct field mode;
    *reading = nothing;
    if (!take_time(fields, reading->time) || !take(fields, &mode) || mode.length != 1
        || !memchr("APSV", mode.text[0], 4))
        return 0;
    reading->mode = mode.text[0];
    return take_count(fields, 0xFFFFFFFF, 10, &reading->sequence)
        && take_number(fields, 1, 4, 3, &reading->x_mm) && take_number(fields, 1, 4, 3, &reading->y_mm)
        && take_number(fields, 1, 2, 4, &reading->yaw_deg)
        && take_number(fields, 1, 2, 4, &reading->pitch_deg)
        && take_number(fields, 1, 2, 4, &reading->roll_deg) && !fields->next;
}

static int read_quality(struct fields *fields, struct altd_reading *reading, int64_t *sequence)
{
    return take_count(fields, 0xFFFFFFFF, 10, sequence) && take_count(fields, 9999, 4, &reading->frames)
        && take_number(fields, 0, 2, 4, &reading->sigma_x_mm)
        && take_number(fields, 0, 2, 4, &reading->sigma_y_mm)
        && take_number(fields, 0, 1, 4, &reading->sigma_yaw_deg)
        && take_number(fields, 0, 1, 4, &reading->sigma_pitch_deg)
        && take_reasons(fields, reading->reasons) && !fields->next;
}

static int read_now(struct fields *fields, struct altd_reading *reading, int64_t *sequence)
{
    return take_count(fields, 0xFFFFFFFF, 10, sequence)
        && take_number(fields, 0, 2, 4, &reading->sigma_now_x_mm)
        && take_number(fields, 0, 2, 4, &reading->sigma_now_y_mm)
        && take_number(fields, 0, 1, 4, &reading->sigma_now_yaw_deg)
        && take_number(fields, 0, 1, 4, &reading->sigma_now_pitch_deg) && !fields->next;
}

static int read_proof(struct fields *fields, struct altd_reading *reading, int64_t *unit, int64_t *crc)
{
    return take_hexadecimal(fields, unit) && take_hexadecimal(fields, &reading->session)
        && take_count(fields, MODULUS - 1, 10, &reading->message) && reading->message != UNKNOWN
        && take_count(fields, MODULUS - 1, 10, &reading->clock_ms) && reading->clock_ms != UNKNOWN
        && take_date(fields, &reading->date) && take_count(fields, 9999999, 7, &reading->age_ms)
        && take_hexadecimal(fields, crc) && !fields->next;
}

/* Whether mode, numbers and reasons agree. */
static int agrees(const struct altd_reading *r)
{
    const double numbers[] = {r->x_mm, r->y_mm, r->yaw_deg, r->pitch_deg,
                              r->sigma_x_mm, r->sigma_y_mm, r->sigma_yaw_deg, r->sigma_pitch_deg};
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++)
        if (isnan(numbers[i]) != (r->mode == 'V'))
            return 0;
    if (r->mode != 'V' && (r->sequence == UNKNOWN || r->frames == UNKNOWN))
        return 0;
    return r->mode != 'A' || !(has_reason(r->reasons, "simulated") || has_reason(r->reasons, "playback"));
}

/* Which of two counters is ahead by how much, modulo MODULUS. */
static uint32_t ahead_of(int64_t last, int64_t now)
{
    return (uint32_t)(now >= last ? now - last : now + MODULUS - last);
}

/* The fault of a telegram whose third sentence is ignored. */
static enum altd_fault disorder(struct altd_telegram *t)
{
    if (t->begun.sequence == UNKNOWN)
        return ALTD_NO_FAULT;
    if (t->sequence != UNKNOWN) {
        uint32_t ahead = (uint32_t)t->begun.sequence - (uint32_t)t->sequence;
        if (ahead >= 0x80000000u || (ahead == 0 && t->begun.mode != 'V'))
            return ALTD_NOT_NEWER;
    }
    t->sequence = t->begun.sequence;
    return ALTD_NO_FAULT;
}

/* The first check of docs/proof.md that a telegram fails, after that of its CRC-32. */
static enum altd_fault fault_of(struct altd_telegram *t, uint32_t now_ms)
{
    if (t->is_foreign)
        return ALTD_FOREIGN;
    if (t->message != UNKNOWN) {
        uint32_t ahead = ahead_of(t->message, t->begun.message);
        if (t->begun.session != t->session)
            return ALTD_RESTARTED;
        if (ahead == 0 || ahead >= MODULUS / 2)
            return ALTD_NOT_NEWER;
        t->lost += ahead - 1;
        t->delay_ms += (now_ms - t->received_ms) * (1 - CLOCK_TOLERANCE);
        t->delay_ms -= ahead_of(t->clock_ms, t->begun.clock_ms);
        if (t->delay_ms < 0)
            t->delay_ms = 0;
    }
    t->session = t->begun.session;
    t->message = t->begun.message;
    t->clock_ms = t->begun.clock_ms;
    t->received_ms = now_ms;
    if (t->begun.mode == 'V')
        return ALTD_NO_FAULT;
    if (t->begun.age_ms == UNKNOWN || (double)t->begun.age_ms + t->delay_ms > t->max_age_ms)
        return ALTD_LATE;
    return ALTD_NO_FAULT;
}

static int drop(struct altd_telegram *t, int is_damaged)
{
    t->damaged += is_damaged || t->sentences > 0;
    t->sentences = 0;
    return 0;
}

/* Give the reading of the sentences so far: the telegram is complete, or its next sentence is missing. */
static int end(struct altd_telegram *t, uint32_t now_ms, struct altd_reading *reading)
{
    enum altd_fault fault;
    if (t->sentences < 2 || !t->is_consistent || !agrees(&t->begun))
        return drop(t, 0);
    if (!t->is_checked)
        fault = disorder(t);
    else
        fault = t->sentences == 3 ? fault_of(t, now_ms) : ALTD_UNCHECKED;
    t->sentences = 0;
    *reading = t->begun;
    reading->fault = fault;
    reading->valid = reading->mode == 'A' && fault == ALTD_NO_FAULT;
    if (fault != ALTD_NO_FAULT) {
        reading->x_mm = reading->y_mm = reading->yaw_deg = reading->pitch_deg = reading->roll_deg = NAN;
        reading->sigma_x_mm = reading->sigma_y_mm = reading->sigma_yaw_deg = reading->sigma_pitch_deg = NAN;
        reading->sigma_now_x_mm = reading->sigma_now_y_mm = NAN;
        reading->sigma_now_yaw_deg = reading->sigma_now_pitch_deg = NAN;
    }
    return 1;
}

/* The end of the body of an intact sentence; NULL: it is none. */
static const char *body_end(const char *line, size_t length)
{
    static const char hexadecimal[] = "0123456789ABCDEF";
    unsigned sum = 0;
    if (length < 6 || length > MAX_SENTENCE || line[0] != '$' || line[length - 5] != '*'
        || line[length - 2] != '\r')
        return NULL;
    for (size_t i = 1; i < length - 5; i++)
        sum ^= (unsigned char)line[i];
    if (line[length - 4] != hexadecimal[sum >> 4] || line[length - 3] != hexadecimal[sum & 15])
        return NULL;
    return line + length - 5;
}

static int take_line(struct altd_telegram *t, uint32_t now_ms, struct altd_reading *reading)
{
    static const char *const names[] = {"PALTM", "PALTQ", "PALTC", "PALTN"};
    struct altd_reading read = t->begun;
    struct fields fields = {t->line + 1, body_end(t->line, t->used)};
    struct field name;
    int64_t sequence = UNKNOWN, unit = UNKNOWN, crc = UNKNOWN;
    int kind = 0, is_read = 1, is_completed = 0, is_dirty = t->is_dirty;

    if (is_dirty)
        drop(t, 1);
    if (!fields.end)
        return drop(t, !is_dirty && !(t->used == 2 && t->line[0] == '\r'));
    take(&fields, &name);
    for (int i = 0; i < 4; i++)
        if (name.length == 5 && memcmp(name.text, names[i], 5) == 0)
            kind = i + 1;
    if (kind == 1)
        is_read = read_measurement(&fields, &read);
    else if (kind == 2)
        is_read = read_quality(&fields, &read, &sequence);
    else if (kind == 3)
        is_read = read_proof(&fields, &read, &unit, &crc);
    else if (kind == 4)
        is_read = read_now(&fields, &read, &sequence);
    if (!is_read)
        return drop(t, !is_dirty);
    if (kind == 4 && t->sentences == 2) {
        if (sequence != read.sequence)
            return drop(t, 0);
        t->begun = read;
        t->crc = crc32_of(t->crc, t->line, t->used);
        return 0;
    }
    if (kind != t->sentences + 1)
        is_completed = end(t, now_ms, reading);
    if (kind != t->sentences + 1)
        return is_completed;

    t->begun = read;
    t->sentences = kind;
    if (kind == 1) {
        t->begun.sigma_now_x_mm = t->begun.sigma_now_y_mm = NAN;
        t->begun.sigma_now_yaw_deg = t->begun.sigma_now_pitch_deg = NAN;
        t->crc = 0;
        t->is_consistent = 1;
    } else if (kind == 2) {
        t->is_consistent = sequence == read.sequence;
    } else {
        size_t covered = (size_t)(fields.end - t->line) - 8;
        t->is_consistent &= crc == crc32_of(t->crc, t->line, covered);
        t->is_foreign = unit != t->unit;
    }
    t->crc = crc32_of(t->crc, t->line, t->used);
    return kind == (t->is_checked ? 3 : 2) ? end(t, now_ms, reading) : is_completed;
}

void altd_telegram_begin(struct altd_telegram *telegram, const char *serial, uint32_t max_age_ms)
{
    memset(telegram, 0, sizeof *telegram);
    telegram->is_checked = serial != NULL;
    telegram->max_age_ms = max_age_ms;
    if (serial)
        telegram->unit = crc32_of(0, serial, strlen(serial));
    if (telegram->unit == MODULUS)
        telegram->unit = MODULUS - 1;
    altd_telegram_restart(telegram);
}

void altd_telegram_restart(struct altd_telegram *telegram)
{
    telegram->used = 0;
    telegram->is_dirty = telegram->sentences = 0;
    telegram->begun = nothing;
    telegram->sequence = telegram->message = UNKNOWN;
    telegram->delay_ms = 0;
}

int altd_telegram_feed(struct altd_telegram *telegram, unsigned char byte, uint32_t now_ms,
                       struct altd_reading *reading)
{
    int is_completed;
    if (byte == '$') {
        telegram->is_dirty |= telegram->used > 0;
        telegram->used = 0;
    }
    if (telegram->used < sizeof telegram->line)
        telegram->line[telegram->used++] = (char)byte; /* a line that is too long stays too long */
    if (byte != '\n')
        return 0;
    is_completed = take_line(telegram, now_ms, reading);
    telegram->used = 0;
    telegram->is_dirty = 0;
    return is_completed;
}
