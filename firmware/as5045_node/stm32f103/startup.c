/* From reset to main: the vector table, and variables as C wants them. No interrupt is used. */
#include <stdint.h>

extern uint32_t stack_top, data_load, data_start, data_end, bss_start, bss_end;

int main(void);
void Reset_Handler(void);

/* A fault is left to the watchdog. */
static void stop(void)
{
    for (;;) {
    }
}

void Reset_Handler(void)
{
    uint32_t *from = &data_load;
    for (uint32_t *to = &data_start; to < &data_end; to++)
        *to = *from++;
    for (uint32_t *to = &bss_start; to < &bss_end; to++)
        *to = 0;
    (void)main();
    stop();
}

__attribute__((section(".vectors"), used)) static const struct {
    const void *stack;
    void (*handler[15])(void);
} vectors = {
    &stack_top,
    {Reset_Handler, stop, stop, stop, stop, stop, 0, 0, 0, 0, stop, stop, 0, stop, stop},
};
