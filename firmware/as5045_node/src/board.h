/* What a board offers to the node: pins, a clock, a CAN controller, a watchdog.
 *
 * Nothing here may block for longer than it says. `context` is handed back to every function.
 */
#ifndef BOARD_H
#define BOARD_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct {
    void *context;
    uint32_t (*now_us)(void *context);              /* free-running, wraps at 2^32 */
    void (*select)(void *context, bool low);        /* CSn of all four chips */
    void (*clock)(void *context, bool high);        /* CLK of all four chips */
    uint8_t (*data)(void *context);                 /* DO of FL, BL, BR, FR in bits 0..3, at one moment */
    void (*wait_half_clock)(void *context);         /* at least 500 ns: the chips take 1 MHz at most */
    uint8_t (*take_back)(void *context);            /* frames that still wait are dropped; how many */
    bool (*send)(void *context, uint32_t id, const uint8_t data[8]); /* false: no room; never waits */
    uint8_t (*times_off_bus)(void *context);        /* since power-on, modulo 256; comes back by itself */
    void (*feed_watchdog)(void *context);
} board_t;

#ifdef __cplusplus
}
#endif
#endif
