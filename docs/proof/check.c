/* Checks the checked block: registers 200 to 279 as the 160 bytes that came. */
#include <stddef.h>
#include <stdint.h>

enum fault { GOOD, CORRUPT, FOREIGN, RESTARTED, NOT_NEWER, LATE, NOT_VALID };

struct check {
    uint32_t unit;     /* CRC-32 of the unit's serial number */
    double limit_ms;   /* the oldest value that may be used */
    int begun;         /* 0 before the first message */
    uint32_t session, message, clock_ms, now_ms;
    double delay_ms;
};

uint32_t crc32_of(const uint8_t *data, size_t length) /* of any wire: block, telegram, JSON */
{
    uint32_t crc = 0xFFFFFFFFu;
    while (length--) {
        crc ^= *data++;
        for (int bit = 0; bit < 8; bit++)
            crc = (crc >> 1) ^ (crc & 1 ? 0xEDB88320u : 0);
    }
    return ~crc;
}

static uint32_t u32(const uint8_t *at)
{
    return (uint32_t)at[0] << 24 | (uint32_t)at[1] << 16 | (uint32_t)at[2] << 8 | at[3];
}

enum fault check(struct check *c, const uint8_t block[160], uint32_t now_ms)
{
    uint32_t session = u32(block + 8), message = u32(block + 12), clock_ms = u32(block + 16);
    if (crc32_of(block, 156) != u32(block + 156) || block[0] != 0 || block[1] != 1)
        return CORRUPT;
    if (u32(block + 4) != c->unit)
        return FOREIGN;
    if (c->begun && session != c->session)
        return RESTARTED;
    if (c->begun && (message == c->message || message - c->message >= 0x80000000u))
        return NOT_NEWER;
    if (c->begun)
        c->delay_ms += (now_ms - c->now_ms) * (1 - 0.0002) - (clock_ms - c->clock_ms);
    if (!c->begun || c->delay_ms < 0)
        c->delay_ms = 0;
    c->begun = 1, c->session = session, c->message = message, c->clock_ms = clock_ms, c->now_ms = now_ms;
    if (u32(block + 36) + c->delay_ms > c->limit_ms)
        return LATE;
    return (block[40] & 0x30) == 0 && (block[41] & 1) ? GOOD : NOT_VALID;
}
