/*
 * A LinuxCNC HAL component that plays a recorded quadrature signal into a counter and writes down what it counts.
 * It has nothing of the project in it: no state table, no count.
 *
 *   feed   puts the next state on the pins a and b          (before the counter in the thread)
 *   idle   does nothing: what HAL's measurement itself costs (after it)
 *   take   writes down rawcounts and the two times          (after that)
 *
 * states=FILE  one byte a state: bit 0 A, bit 1 B
 * counts=FILE  three 32-bit words a state: the counter's count, the TSC cycles that its function took as HAL measured
 *              them, and those of the idle function. A time is the newest that HAL has, of this call or the one before.
 *
 * Licence: MIT OR Apache-2.0, as the project. Compiled against LinuxCNC's headers on the machine that runs it.
 */
#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "hal.h"
#include "rtapi.h"
#include "rtapi_app.h"

MODULE_LICENSE("GPL");
static char *states = "";
RTAPI_MP_STRING(states, "file of states to play");
static char *counts = "";
RTAPI_MP_STRING(counts, "file that takes the counts");

static struct pins {
    hal_bit_t *a, *b, *done;
    hal_u32_t *at;
    hal_s32_t *rawcounts, *cycles, *idle_cycles;
} *pins;

static const unsigned char *played;
static struct record { int count, cycles, idle_cycles; } *taken;
static size_t length, at;
static int component;

static void feed(void *unused, long period)
{
    (void)unused, (void)period;
    if (at < length) {
        *pins->a = played[at] & 1;
        *pins->b = played[at] >> 1 & 1;
    }
}

static void idle(void *unused, long period)
{
    (void)unused, (void)period;
}

static void take(void *unused, long period)
{
    (void)unused, (void)period;
    if (at < length) {
        taken[at].count = *pins->rawcounts;
        taken[at].cycles = *pins->cycles;
        taken[at].idle_cycles = *pins->idle_cycles;
        *pins->at = ++at;
    } else {
        *pins->done = 1;
    }
}

static int open_files(void)
{
    struct stat status;
    int in = open(states, O_RDONLY), out = open(counts, O_RDWR);
    if (in < 0 || out < 0 || fstat(in, &status) != 0 || status.st_size == 0)
        return -1;
    length = status.st_size;
    if (ftruncate(out, length * sizeof *taken) != 0)
        return -1;
    played = mmap(NULL, length, PROT_READ, MAP_SHARED | MAP_POPULATE, in, 0);
    taken = mmap(NULL, length * sizeof *taken, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE, out, 0);
    close(in);
    close(out);
    return played == MAP_FAILED || taken == MAP_FAILED ? -1 : 0;
}

static int export(void)
{
    int failed = 0;
    failed |= hal_pin_bit_newf(HAL_OUT, &pins->a, component, "rtec-judge.a");
    failed |= hal_pin_bit_newf(HAL_OUT, &pins->b, component, "rtec-judge.b");
    failed |= hal_pin_bit_newf(HAL_OUT, &pins->done, component, "rtec-judge.done");
    failed |= hal_pin_u32_newf(HAL_OUT, &pins->at, component, "rtec-judge.at");
    failed |= hal_pin_s32_newf(HAL_IN, &pins->rawcounts, component, "rtec-judge.rawcounts");
    failed |= hal_pin_s32_newf(HAL_IN, &pins->cycles, component, "rtec-judge.cycles");
    failed |= hal_pin_s32_newf(HAL_IN, &pins->idle_cycles, component, "rtec-judge.idle-cycles");
    failed |= hal_export_funct("rtec-judge.feed", feed, NULL, 0, 0, component);
    failed |= hal_export_funct("rtec-judge.idle", idle, NULL, 0, 0, component);
    failed |= hal_export_funct("rtec-judge.take", take, NULL, 0, 0, component);
    return failed;
}

int rtapi_app_main(void)
{
    component = hal_init("rtec_judge");
    if (component < 0)
        return component;
    pins = hal_malloc(sizeof *pins);
    if (pins == NULL || open_files() != 0 || export() != 0) {
        rtapi_print_msg(RTAPI_MSG_ERR, "rtec_judge: cannot play '%s' into '%s'\n", states, counts);
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
