/* The node on a Teensy 4.0 or 4.1 with a 3.3 V CAN transceiver, 500 kbit/s, by FlexCAN_T4.
 *
 * 14..17  DO of FL, BL, BR, FR (pull-up)      23, 22  CAN1 RX, TX
 * 2, 3    CSn, CLK of all four chips          4, 5    address: to ground adds 4, 8
 */
#include <FlexCAN_T4.h>
#include <node.h>

static FlexCAN_T4<CAN1, RX_SIZE_16, TX_SIZE_16> can;
static node_t node;
static uint8_t timesOffBus;

static const uint8_t FIRST_BOX = 8, BOXES = 3; /* the library's mailboxes that send begin at 8 */

static volatile uint32_t &box(int i) { return FLEXCANb_MBn_CS(CAN1, FIRST_BOX + i); }

static uint32_t nowUs(void *) { return micros(); }
static void selectChips(void *, bool low) { digitalWriteFast(2, !low); }
static void setClock(void *, bool high) { digitalWriteFast(3, high); }
static void waitHalfClock(void *) { delayNanoseconds(520); }

static uint8_t dataLines(void *)
{
    return digitalReadFast(14) | digitalReadFast(15) << 1 | digitalReadFast(16) << 2 | digitalReadFast(17) << 3;
}

static uint8_t takeBack(void *)
{
    uint8_t waiting = 0;
    for (int i = 0; i < BOXES; i++)
        if (FLEXCAN_get_code(box(i)) == FLEXCAN_MB_CODE_TX_ONCE) {
            box(i) = FLEXCAN_MB_CS_CODE(FLEXCAN_MB_CODE_TX_ABORT);
            waiting++;
        }
    const uint32_t began = micros();
    for (int i = 0; waiting && i < BOXES; i++) {
        while (FLEXCAN_get_code(box(i)) == FLEXCAN_MB_CODE_TX_ONCE && micros() - began < 300) {
        }
        box(i) = FLEXCAN_MB_CS_CODE(FLEXCAN_MB_CODE_TX_INACTIVE);
    }
    return waiting;
}

static bool sendFrame(void *, uint32_t id, const uint8_t data[8])
{
    for (int i = 0; i < BOXES; i++)
        if (FLEXCAN_get_code(box(i)) == FLEXCAN_MB_CODE_TX_INACTIVE) {
            CAN_message_t message;
            message.id = id;
            message.len = 8;
            memcpy(message.buf, data, 8);
            return can.write((FLEXCAN_MAILBOX)(FIRST_BOX + i), message) == 1;
        }
    return false;
}

static uint8_t offBus(void *) { return timesOffBus; }

static void feedWatchdog(void *)
{
    WDOG1_WSR = 0x5555;
    WDOG1_WSR = 0xAAAA;
}

static void startWatchdog()
{
    CCM_CCGR3 |= CCM_CCGR3_WDOG1(3);
    WDOG1_WMCR = 0;
    WDOG1_WCR = WDOG_WCR_WT(0) | WDOG_WCR_WDE | WDOG_WCR_WDA | WDOG_WCR_SRS; /* half a second */
}

static uint8_t resetCause()
{
    const uint32_t flags = SRC_SRSR;
    SRC_SRSR = flags;
    if (flags & (SRC_SRSR_WDOG_RST_B | SRC_SRSR_WDOG3_RST_B))
        return 1;
    if (flags & SRC_SRSR_LOCKUP_SYSRESETREQ)
        return 3;
    return flags & SRC_SRSR_IPP_USER_RESET_B ? 2 : 0;
}

static const board_t board = {
    nullptr, nowUs, selectChips, setClock, dataLines, waitHalfClock, takeBack, sendFrame, offBus, feedWatchdog,
};

void setup()
{
    const uint8_t cause = resetCause();
    for (uint8_t pin : {14, 15, 16, 17, 4, 5})
        pinMode(pin, INPUT_PULLUP);
    for (uint8_t pin : {2, 3}) {
        digitalWriteFast(pin, HIGH);
        pinMode(pin, OUTPUT);
    }
    can.begin();
    can.setBaudRate(500000);
    delay(1);
    const uint32_t address = 4 * (!digitalReadFast(4) + 2 * !digitalReadFast(5));
    startWatchdog();
    node_begin(&node, &board, address, NODE_RATE_HZ, cause);
}

void loop()
{
    static bool wasOff;
    const bool off = (FLEXCANb_ESR1(CAN1) >> 4 & 3) > 1; /* FLTCONF; the controller comes back by itself */
    timesOffBus += off && !wasOff;
    wasOff = off;
    (void)node_poll(&node);
}
