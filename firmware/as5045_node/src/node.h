/* The node: when it samples, what it counts, what it sends. The board calls `node_poll` without end. */
#ifndef NODE_H
#define NODE_H

#include "as5045.h"
#include "frames.h"

#ifdef __cplusplus
extern "C" {
#endif

#define NODE_FIRMWARE 1
#define NODE_RATE_HZ 200u

typedef struct {
    const board_t *board;
    uint32_t address;      /* added to the frames' identifiers */
    uint32_t period_us;
    uint32_t due_us;       /* of the next sample set, board clock */
    uint32_t last_us;      /* board clock when `time_us` was brought up to date */
    uint64_t time_us;      /* since the start; does not wrap with the board's clock */
    uint32_t sets;
    frame_status_t status;
} node_t;

/* Ready for the first set, one period from now.
 *
 * address: of the node, 0 to 63. Leave three free between two nodes: each has three identifiers.
 * rate_hz: sample sets per second, 1 to 1000.
 * reset_cause: as in `frame_status_t`.
 */
void node_begin(node_t *node, const board_t *board, uint32_t address, uint32_t rate_hz, uint8_t reset_cause);

/* Sample and send if a set is due. Returns whether one was. Takes below 50 us plus what `send` takes. */
bool node_poll(node_t *node);

#ifdef __cplusplus
}
#endif
#endif
