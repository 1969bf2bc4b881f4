/* The node on an STM32F103C8 ("Blue Pill", 8 MHz crystal) with a 3.3 V CAN transceiver, 500 kbit/s.
 *
 * PA0..PA3  DO of FL, BL, BR, FR (pull-up)      PB8, PB9  CAN RX, TX
 * PB12, PB13  CSn, CLK of all four chips        PB0, PB1  address: to ground adds 4, 8
 */
#include "node.h"
#include "registers.h"

enum { POWER, WATCHDOG, PIN, SOFTWARE };

static uint32_t now_us(void *context)
{
    static uint32_t time_us;
    (void)context;
    time_us += (uint16_t)(TIM2_CNT - (uint16_t)time_us); /* asked far more often than every 65 ms */
    return time_us;
}

static void select_chips(void *context, bool low)
{
    (void)context;
    GPIOB_BSRR = low ? 1u << (12 + 16) : 1u << 12;
}

static void set_clock(void *context, bool high)
{
    (void)context;
    GPIOB_BSRR = high ? 1u << 13 : 1u << (13 + 16);
}

static uint8_t data_lines(void *context)
{
    (void)context;
    return (uint8_t)(GPIOA_IDR & 0xF);
}

static void wait_half_clock(void *context)
{
    (void)context;
    for (int i = 0; i < 36; i++) /* 36 instructions and more at 72 MHz: 500 ns */
        __asm__ volatile("nop");
}

static uint8_t take_back(void *context)
{
    uint8_t waiting = 0;
    (void)context;
    for (int box = 0; box < 3; box++)
        if (!(CAN_TSR & 1u << (26 + box))) {
            CAN_TSR = 1u << (7 + 8 * box); /* ABRQ; writing zeros elsewhere changes nothing */
            waiting++;
        }
    for (int i = 0; waiting && (CAN_TSR >> 26 & 7) != 7 && i < 10000; i++) { /* one frame at most: 0.3 ms */
    }
    return waiting;
}

static bool send_frame(void *context, uint32_t id, const uint8_t data[8])
{
    (void)context;
    for (int box = 0; box < 3; box++)
        if (CAN_TSR & 1u << (26 + box)) {
            CAN_TDT(box) = 8;
            CAN_TDL(box) = data[0] | (uint32_t)data[1] << 8 | (uint32_t)data[2] << 16 | (uint32_t)data[3] << 24;
            CAN_TDH(box) = data[4] | (uint32_t)data[5] << 8 | (uint32_t)data[6] << 16 | (uint32_t)data[7] << 24;
            CAN_TI(box) = id << 21 | 1; /* standard identifier, and go */
            return true;
        }
    return false;
}

static uint8_t times_off_bus;

static uint8_t off_bus(void *context)
{
    (void)context;
    return times_off_bus;
}

/* The controller comes back by itself (ABOM); here it is only counted. */
static void watch_bus(void)
{
    static bool was_off;
    const bool off = CAN_ESR >> 2 & 1;
    if (off && !was_off)
        times_off_bus++;
    was_off = off;
}

static void feed_watchdog(void *context)
{
    (void)context;
    IWDG_KR = 0xAAAA;
}

static void start_watchdog(void)
{
    IWDG_KR = 0xCCCC;
    IWDG_KR = 0x5555;
    IWDG_PR = 0;      /* 40 kHz / 4 */
    IWDG_RLR = 1000;  /* 100 ms */
    IWDG_KR = 0xAAAA;
}

static void start_clock(void)
{
    RCC_CR |= 1u << 16; /* crystal; without one the watchdog resets us, again and again */
    while (!(RCC_CR & 1u << 17)) {
    }
    FLASH_ACR = 0x12;                                  /* prefetch, two wait states */
    RCC_CFGR = 7u << 18 | 1u << 16 | 4u << 8;          /* 8 MHz x 9, APB1 at 36 MHz */
    RCC_CR |= 1u << 24;
    while (!(RCC_CR & 1u << 25)) {
    }
    RCC_CFGR |= 2;
    while ((RCC_CFGR >> 2 & 3) != 2) {
    }
}

static void start_pins(void)
{
    RCC_APB2ENR |= 1u << 0 | 1u << 2 | 1u << 3; /* AFIO, port A, port B */
    AFIO_MAPR = 2u << 13;                       /* CAN on PB8 and PB9 */
    GPIOA_BSRR = 0xF;                           /* pulled up: a chip that is not there reads as all ones */
    GPIOA_CRL = 0x44448888;
    GPIOB_BSRR = 3u << 0 | 3u << 12;
    GPIOB_CRL = 0x44444488;                     /* PB0, PB1 inputs, pulled up */
    GPIOB_CRH = 0x441144B4;                     /* PB9 CAN, PB8 input, PB12 and PB13 outputs */
}

static void start_timer(void)
{
    RCC_APB1ENR |= 1u << 0 | 1u << 25; /* TIM2, CAN */
    TIM2_PSC = 71;                     /* 1 MHz */
    TIM2_ARR = 0xFFFF;
    TIM2_EGR = 1;
    TIM2_CR1 = 1;
}

static void start_can(void)
{
    CAN_MCR = 1u << 0;
    while (!(CAN_MSR & 1)) {
    }
    CAN_MCR = 1u << 6 | 1u << 2 | 1u << 0;           /* back on the bus by itself, first in first out */
    CAN_BTR = 1u << 24 | 1u << 20 | 14u << 16 | 3;   /* 36 MHz / 4 / (1 + 15 + 2) = 500 kbit/s, sampled at 89 % */
    CAN_MCR = 1u << 6 | 1u << 2;                     /* leaves once it has seen an idle bus */
}

static uint8_t reset_cause(void)
{
    const uint32_t flags = RCC_CSR;
    RCC_CSR = 1u << 24;
    if (flags & (1u << 29 | 1u << 30))
        return WATCHDOG;
    if (flags & 1u << 28)
        return SOFTWARE;
    return flags & 1u << 27 ? POWER : PIN;
}

static const board_t board = {
    0, now_us, select_chips, set_clock, data_lines, wait_half_clock,
    take_back, send_frame, off_bus, feed_watchdog,
};

int main(void)
{
    static node_t node;
    start_watchdog();
    start_clock();
    start_pins();
    start_timer();
    start_can();
    const uint32_t address = (~GPIOB_IDR & 3u) * 4;
    node_begin(&node, &board, address, NODE_RATE_HZ, reset_cause());
    for (;;) {
        watch_bus();
        (void)node_poll(&node);
    }
}
