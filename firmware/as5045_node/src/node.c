/* Sets are due on a grid of the board's clock. A set that cannot be sent is dropped, never kept: the host
 * wants the present angle, and reads from the sequence number that sets are missing.
 */
#include "node.h"

static uint32_t advance(node_t *node, uint32_t now_us)
{
    node->time_us += now_us - node->last_us;
    node->last_us = now_us;
    return (uint32_t)(node->time_us / 10);
}

void node_begin(node_t *node, const board_t *board, uint32_t address, uint32_t rate_hz, uint8_t reset_cause)
{
    const frame_status_t fresh = {NODE_FIRMWARE, (uint16_t)rate_hz, reset_cause, 0, 0, 0, 0};
    node->board = board;
    node->address = address;
    node->period_us = 1000000u / rate_hz;
    node->time_us = 0;
    node->sets = 0;
    node->status = fresh;
    (void)as5045_read(board); /* the first word after power-on is wrong */
    node->last_us = board->now_us(board->context);
    node->due_us = node->last_us + node->period_us;
}

static void send(node_t *node, uint32_t id, const uint8_t data[8])
{
    const board_t *board = node->board;
    if (!board->send(board->context, id + node->address, data))
        node->status.unsent_frames++;
}

static void send_set(node_t *node, const as5045_reading_t *reading)
{
    const board_t *board = node->board;
    uint8_t left[8], right[8];
    const uint32_t time_10us = advance(node, reading->at_us);

    frames_of_set(reading->word, (uint8_t)node->sets, time_10us, left, right);
    node->status.unsent_frames += board->take_back(board->context);
    send(node, FRAME_LEFT, left);
    send(node, FRAME_RIGHT, right);
    if (node->sets++ % node->status.rate_hz == 0) {
        uint8_t data[8];
        node->status.times_off_bus = board->times_off_bus(board->context);
        frame_of_status(&node->status, data);
        send(node, FRAME_STATUS, data);
    }
}

bool node_poll(node_t *node)
{
    const board_t *board = node->board;
    const uint32_t now_us = board->now_us(board->context);
    const int32_t late_us = (int32_t)(now_us - node->due_us);

    if (late_us < 0)
        return false;
    node->due_us += node->period_us;
    if ((uint32_t)late_us >= node->period_us) {
        node->status.late_sets++;
        node->due_us = now_us + node->period_us;
    }
    const as5045_reading_t reading = as5045_read(board);
    for (int chip = 0; chip < AS5045_CHIPS; chip++)
        if (!as5045_parity_holds(reading.word[chip]))
            node->status.parity_errors++;
    send_set(node, &reading);
    board->feed_watchdog(board->context);
    return true;
}
