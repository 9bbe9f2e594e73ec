/* Lets a terminal answer TIOCSRS485 as a serial driver does, in the words of the kernel's own header: loaded before the
 * C library (LD_PRELOAD). A pseudo terminal has no RS485 mode, and no port on a test machine has one.
 * RS485_PORT says what the driver cannot do; what it was asked goes to the file RS485_LOG. */
#define _GNU_SOURCE
#include <errno.h>
#include <dlfcn.h>
#include <linux/serial.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>

int ioctl(int descriptor, unsigned long request, ...)
{
    va_list arguments;
    va_start(arguments, request);
    void *argument = va_arg(arguments, void *);
    va_end(arguments);
    if (request != TIOCSRS485) {
        int (*next)(int, unsigned long, ...) = dlsym(RTLD_NEXT, "ioctl");
        return next(descriptor, request, argument);
    }
    struct serial_rs485 *mode = argument;
    FILE *log = fopen(getenv("RS485_LOG"), "a");
    fprintf(log, "%s%s%s%s before %u after %u\n", mode->flags & SER_RS485_ENABLED ? "enabled" : "disabled",
            mode->flags & SER_RS485_RTS_ON_SEND ? " on-send" : "",
            mode->flags & SER_RS485_RTS_AFTER_SEND ? " after-send" : "",
            mode->flags & SER_RS485_RX_DURING_TX ? " rx-during-tx" : "",
            mode->delay_rts_before_send, mode->delay_rts_after_send);
    fclose(log);
    const char *cannot = getenv("RS485_PORT");
    if (!strcmp(cannot, "mode")) {
        errno = EINVAL;
        return -1;
    }
    if (!strcmp(cannot, "enable"))
        mode->flags = 0;
    if (!strcmp(cannot, "low")) {
        mode->flags |= SER_RS485_RTS_ON_SEND;
        mode->flags &= ~SER_RS485_RTS_AFTER_SEND;
    }
    if (!strcmp(cannot, "delay"))
        mode->delay_rts_after_send = 0;
    return 0;
}
