/* The serial interface by hand: the first falling edge of CLK makes the chips hold their angle, each rising
 * edge puts the next bit on DO, most significant first (ams AS5045 datasheet, "Synchronous Serial Interface").
 * CSn and CLK go to all four chips, so that the four angles are of one moment.
 */
#include "as5045.h"

as5045_reading_t as5045_read(const board_t *board)
{
    as5045_reading_t reading = {{0, 0, 0, 0}, 0};
    void *context = board->context;

    board->clock(context, true);
    board->select(context, true);
    board->wait_half_clock(context);
    reading.at_us = board->now_us(context);
    for (int bit = 0; bit < AS5045_BITS; bit++) {
        board->clock(context, false);
        board->wait_half_clock(context);
        board->clock(context, true);
        board->wait_half_clock(context);
        const uint8_t lines = board->data(context);
        for (int chip = 0; chip < AS5045_CHIPS; chip++)
            reading.word[chip] = reading.word[chip] << 1 | (uint32_t)(lines >> chip & 1);
    }
    board->select(context, false);
    board->wait_half_clock(context);
    return reading;
}

bool as5045_parity_holds(uint32_t word)
{
    word ^= word >> 16;
    word ^= word >> 8;
    word ^= word >> 4;
    word ^= word >> 2;
    word ^= word >> 1;
    return !(word & 1);
}
