/* Signals are little-endian ("Intel" in a DBC): bit n of a frame is bit n % 8 of byte n / 8. */
#include "frames.h"

static void put(uint8_t data[8], uint64_t bits)
{
    for (int i = 0; i < 8; i++)
        data[i] = (uint8_t)(bits >> 8 * i);
}

static uint64_t set_of(uint32_t first, uint32_t second, uint8_t sequence, uint32_t time_10us)
{
    return (uint64_t)(first & 0x3FFFFu) | (uint64_t)(second & 0x3FFFFu) << 18 | (uint64_t)sequence << 36
           | (uint64_t)(time_10us & 0xFFFFFu) << 44;
}

void frames_of_set(const uint32_t word[4], uint8_t sequence, uint32_t time_10us, uint8_t left[8],
                   uint8_t right[8])
{
    put(left, set_of(word[0], word[1], sequence, time_10us));
    put(right, set_of(word[2], word[3], sequence, time_10us));
}

void frame_of_status(const frame_status_t *status, uint8_t data[8])
{
    put(data, (uint64_t)FRAME_LAYOUT | (uint64_t)status->firmware << 8
                  | (uint64_t)(status->rate_hz & 0xFFFu) << 16 | (uint64_t)(status->reset_cause & 0xFu) << 28
                  | (uint64_t)status->parity_errors << 32 | (uint64_t)status->late_sets << 40
                  | (uint64_t)status->unsent_frames << 48 | (uint64_t)status->times_off_bus << 56);
}
