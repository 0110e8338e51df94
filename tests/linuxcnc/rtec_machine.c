/*
 * A LinuxCNC HAL component that stands for a machine's drives and counter card: speed commands go out, counts come
 * back, once a servo period, through a mapped file. A program on its other side moves the axes for one period and
 * answers; this side waits for it, so that neither has to keep up with a clock.
 *
 * card=FILE, 32-bit words:
 *   0x00 asked      number of the period, counted up by us after the words below it are written
 *   0x04 answered   set to `asked` by the machine after its words are written
 *   0x08 0x0c       speed command of axis 0, 1, in nm/s                             (we write)
 *   0x10 0x14       commanded position of axis 0, 1, in nm: for the record only     (we write)
 *   0x18 0x1c       the counter card's counts of axis 0, 1                          (the machine writes)
 *   0x20            bit 0 feed hold, bit 1 the decoder saw an illegal transition,
 *                   bit 2 the probe touches                                         (the machine writes)
 *
 * Licence: MIT OR Apache-2.0, as the project. Compiled against LinuxCNC's headers on the machine that runs it.
 */
#include <fcntl.h>
#include <sched.h>
#include <stdint.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include "hal.h"
#include "rtapi.h"
#include "rtapi_app.h"

MODULE_LICENSE("GPL");
static char *card = "";
RTAPI_MP_STRING(card, "mapped file of the machine");

enum { AXES = 2, BYTES = 0x40, PATIENCE_S = 5 };

struct words {
    volatile uint32_t asked, answered;
    volatile int32_t speed_nm_s[AXES], command_nm[AXES], counts[AXES];
    volatile uint32_t lines;
};

static struct pins {
    hal_float_t *speed[AXES], *command[AXES], *scale[AXES], *position[AXES];
    hal_s32_t *counts[AXES];
    hal_bit_t *hold, *fault, *probe, *lost;
} *pins;

static struct words *words;
static int component;

static int32_t nano(double milli)
{
    double value = milli * 1e6;
    return value > INT32_MAX ? INT32_MAX : value < -INT32_MAX ? -INT32_MAX : (int32_t)value;
}

/* The machine answers within a fraction of a period, or is lost: the controller must see that, and stop. */
static int answered(void)
{
    struct timespec start, now;
    clock_gettime(CLOCK_MONOTONIC, &start);
    for (unsigned n = 0; words->answered != words->asked; n++) {
        if (n > 1000)
            sched_yield();
        if (n % 1024 == 0) {
            clock_gettime(CLOCK_MONOTONIC, &now);
            if (now.tv_sec - start.tv_sec > PATIENCE_S)
                return 0;
        }
    }
    return 1;
}

static void period(void *unused, long period_ns)
{
    (void)unused, (void)period_ns;
    if (*pins->lost)
        return;
    for (int n = 0; n < AXES; n++) {
        words->speed_nm_s[n] = nano(*pins->speed[n]);
        words->command_nm[n] = nano(*pins->command[n]);
    }
    __sync_synchronize();
    words->asked++;
    if (!answered()) {
        *pins->lost = *pins->fault = 1;
        rtapi_print_msg(RTAPI_MSG_ERR, "rtec_machine: no answer from the machine\n");
        return;
    }
    __sync_synchronize();
    for (int n = 0; n < AXES; n++) {
        *pins->counts[n] = words->counts[n];
        *pins->position[n] = words->counts[n] * *pins->scale[n];
    }
    *pins->hold = words->lines & 1;
    *pins->fault = words->lines >> 1 & 1;
    *pins->probe = words->lines >> 2 & 1;
}

static int export(void)
{
    int failed = 0;
    for (int n = 0; n < AXES; n++) {
        failed |= hal_pin_float_newf(HAL_IN, &pins->speed[n], component, "rtec-machine.%d.speed", n);
        failed |= hal_pin_float_newf(HAL_IN, &pins->command[n], component, "rtec-machine.%d.command", n);
        failed |= hal_pin_float_newf(HAL_IN, &pins->scale[n], component, "rtec-machine.%d.mm-per-count", n);
        failed |= hal_pin_float_newf(HAL_OUT, &pins->position[n], component, "rtec-machine.%d.position", n);
        failed |= hal_pin_s32_newf(HAL_OUT, &pins->counts[n], component, "rtec-machine.%d.counts", n);
    }
    failed |= hal_pin_bit_newf(HAL_OUT, &pins->hold, component, "rtec-machine.hold");
    failed |= hal_pin_bit_newf(HAL_OUT, &pins->fault, component, "rtec-machine.fault");
    failed |= hal_pin_bit_newf(HAL_OUT, &pins->probe, component, "rtec-machine.probe");
    failed |= hal_pin_bit_newf(HAL_OUT, &pins->lost, component, "rtec-machine.lost");
    failed |= hal_export_funct("rtec-machine.period", period, NULL, 1, 0, component);
    return failed;
}

static int map_card(void)
{
    int file = open(card, O_RDWR);
    if (file < 0)
        return -1;
    words = mmap(NULL, BYTES, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    close(file);
    return words == MAP_FAILED ? -1 : 0;
}

int rtapi_app_main(void)
{
    component = hal_init("rtec_machine");
    if (component < 0)
        return component;
    pins = hal_malloc(sizeof *pins);
    if (pins == NULL || map_card() != 0 || export() != 0) {
        rtapi_print_msg(RTAPI_MSG_ERR, "rtec_machine: cannot use the card '%s'\n", card);
        hal_exit(component);
        return -1;
    }
    hal_ready(component);
    return 0;
}

void rtapi_app_exit(void)
{
    hal_exit(component);
}
