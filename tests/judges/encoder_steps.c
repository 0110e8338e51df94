/*
 * So many calls of LinuxCNC's own encoder.update-counters on its three channels, and nothing else, for callgrind.
 *
 *   encoder_steps ENCODER.so still|moving|correcting update|nothing N
 *
 * The edges are those of `engine_steps`: none; one on each channel at every call; one on each every 32 calls. `nothing`
 * calls an empty function in its place: what remains of the difference is LinuxCNC's. Prints what channel 0 counted.
 *
 * The component is Debian's, as compiled there. Of HAL it is given only what it asks for when it is loaded: memory for
 * its pins. No pin is connected and no thread runs, so that nothing but the function is counted.
 *
 * Licence: MIT OR Apache-2.0, as the project. Compiled against LinuxCNC's headers on the machine that runs it.
 */
#include <dlfcn.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "hal.h"
#include "rtapi.h"

#define CHANNELS 3
#define PERIOD_NS 1000

static hal_bit_t *a[CHANNELS], *b[CHANNELS];
static hal_s32_t *rawcounts;
static void (*update)(void *, long), *argument;

static void nothing(void *unused, long period)
{
    (void)unused, (void)period;
}

/* What rtapi and HAL do for a component that is being loaded. */
int rtapi_get_msg_level(void) { return RTAPI_MSG_NONE; }
int rtapi_set_msg_level(int level) { return (void)level, 0; }
void rtapi_print_msg(msg_level_t level, const char *format, ...) { (void)level, (void)format; }
int hal_init(const char *name) { return (void)name, 1; }
int hal_ready(int component) { return (void)component, 0; }
int hal_exit(int component) { return (void)component, 0; }
void *hal_malloc(long int size) { return calloc(1, size); }

int rtapi_snprintf(char *text, unsigned long int size, const char *format, ...)
{
    va_list all;
    va_start(all, format);
    int length = vsnprintf(text, size, format, all);
    va_end(all);
    return length;
}

int hal_export_funct(const char *name, void (*function)(void *, long), void *of, int fp, int reentrant, int component)
{
    (void)fp, (void)reentrant, (void)component;
    if (strcmp(name, "encoder.update-counters") == 0) {
        update = function;
        argument = of;
    }
    return 0;
}

/* Every pin has memory of its own, as one that is not connected has. */
static void *pin(const char *format, va_list all)
{
    char name[HAL_NAME_LEN + 1];
    int channel;
    hal_data_u *value = calloc(1, sizeof *value);
    vsnprintf(name, sizeof name, format, all);
    const char *of = name + strlen("encoder.0.");
    if (sscanf(name, "encoder.%d.", &channel) == 1 && channel < CHANNELS) {
        if (strcmp(of, "phase-A") == 0)
            a[channel] = &value->b;
        if (strcmp(of, "phase-B") == 0)
            b[channel] = &value->b;
        if (strcmp(of, "rawcounts") == 0 && channel == 0)
            rawcounts = &value->s;
    }
    return value;
}

#define PIN(kind, type)                                                                                 \
    int hal_pin_##kind##_newf(hal_pin_dir_t direction, type **data, int component, const char *format, ...) \
    {                                                                                                   \
        va_list all;                                                                                    \
        (void)direction, (void)component;                                                               \
        va_start(all, format);                                                                          \
        *data = pin(format, all);                                                                       \
        va_end(all);                                                                                    \
        return 0;                                                                                       \
    }
PIN(bit, hal_bit_t)
PIN(float, hal_float_t)
PIN(s32, hal_s32_t)

int main(int count, char **arguments)
{
    if (count != 5) {
        fprintf(stderr, "usage: %s ENCODER.so still|moving|correcting update|nothing N\n", arguments[0]);
        return 2;
    }
    void *module = dlopen(arguments[1], RTLD_NOW);
    int (*load)(void) = module ? (int (*)(void))dlsym(module, "rtapi_app_main") : NULL;
    if (load == NULL || load() != 0 || update == NULL || rawcounts == NULL || a[CHANNELS - 1] == NULL) {
        fprintf(stderr, "%s: not LinuxCNC's encoder: %s\n", arguments[1], module ? "it did not load" : dlerror());
        return 1;
    }
    long every = strcmp(arguments[2], "moving") == 0 ? 1 : strcmp(arguments[2], "correcting") == 0 ? 32 : -1;
    void (*function)(void *, long) = strcmp(arguments[3], "update") == 0 ? update : nothing;
    for (long n = strtol(arguments[4], NULL, 10), until = every; n > 0; n--) {
        if (--until == 0) {
            until = every;
            int turn_a = *a[0] == *b[0];
            for (int channel = 0; channel < CHANNELS; channel++) {
                hal_bit_t *line = turn_a ? a[channel] : b[channel];
                *line = !*line;
            }
        }
        function(argument, PERIOD_NS);
    }
    printf("%d\n", (int)*rawcounts);
    return 0;
}
