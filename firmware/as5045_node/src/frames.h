/* The frames of the node, as `hil/config/as5045.dbc` describes them. */
#ifndef FRAMES_H
#define FRAMES_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define FRAME_LEFT 0x1A0u   /* plus the node's address */
#define FRAME_RIGHT 0x1A1u
#define FRAME_STATUS 0x1A2u
#define FRAME_LAYOUT 1      /* counts up when the bits of a frame move */

typedef struct {
    uint8_t firmware;
    uint16_t rate_hz;        /* 12 bits */
    uint8_t reset_cause;     /* 4 bits: 0 power, 1 watchdog, 2 reset pin, 3 software */
    uint8_t parity_errors;   /* this one and the next three count modulo 256 */
    uint8_t late_sets;
    uint8_t unsent_frames;
    uint8_t times_off_bus;
} frame_status_t;

/* One sample set: words in the order FL BL BR FR, time in units of 10 us. */
void frames_of_set(const uint32_t word[4], uint8_t sequence, uint32_t time_10us, uint8_t left[8],
                   uint8_t right[8]);

void frame_of_status(const frame_status_t *status, uint8_t data[8]);

#ifdef __cplusplus
}
#endif
#endif
