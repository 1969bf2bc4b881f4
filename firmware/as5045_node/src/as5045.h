/* Four AS5045 read at one moment over their serial interface (SSI). */
#ifndef AS5045_H
#define AS5045_H

#include "board.h"

#ifdef __cplusplus
extern "C" {
#endif

#define AS5045_CHIPS 4
#define AS5045_BITS 18

typedef struct {
    uint32_t word[AS5045_CHIPS]; /* FL BL BR FR: D11..D0 OCF COF LIN MagINC MagDEC parity */
    uint32_t at_us;              /* the board's clock when all four held their angle */
} as5045_reading_t;

as5045_reading_t as5045_read(const board_t *board);

/* Whether the number of ones is even, as it is in every word that arrived whole. */
bool as5045_parity_holds(uint32_t word);

#ifdef __cplusplus
}
#endif
#endif
