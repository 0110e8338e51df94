#!/usr/bin/python3
"""LinuxCNC's operator: switches the machine on, homes it, runs part.ngc and leaves.

Started by LinuxCNC as its DISPLAY, with `-ini FILE`. What happened goes to operator.log; `ended` is its last line
only if the program ran to its end.
"""

import sys
import time

import linuxcnc

log = open("operator.log", "w", buffering=1)
command, status, errors = linuxcnc.command(), linuxcnc.stat(), linuxcnc.error_channel()


def complaints():
    """Logs what LinuxCNC says; a program that it refuses ends idle like one that has run, so an error ends us too."""
    failed = False
    while (message := errors.poll()) is not None:
        log.write(f"LinuxCNC: {message[1]}\n")
        failed |= message[0] in (linuxcnc.OPERATOR_ERROR, linuxcnc.NML_ERROR)
    if failed:
        sys.exit(1)


def until(what, condition, patience_s):
    """Waits for a condition; a machine that does not get there in time has failed."""
    end = time.monotonic() + patience_s
    while True:
        status.poll()
        complaints()
        if condition():
            log.write(f"{what}\n")
            return
        if time.monotonic() > end:
            log.write(
                f"not {what}: state {status.task_state}, mode {status.task_mode}, interp {status.interp_state},"
                f" homed {status.homed[:2]}, position {status.actual_position[:3]}\n"
            )
            sys.exit(1)
        time.sleep(0.02)


command.state(linuxcnc.STATE_ESTOP_RESET)
until("e-stop reset", lambda: status.task_state in (linuxcnc.STATE_ESTOP_RESET, linuxcnc.STATE_OFF), 10)
command.state(linuxcnc.STATE_ON)
until("on", lambda: status.task_state == linuxcnc.STATE_ON, 10)
command.mode(linuxcnc.MODE_MANUAL)
command.wait_complete()
command.teleop_enable(0)
command.wait_complete()
command.home(-1)
until("homed", lambda: status.homed[0] and status.homed[1], 10)
command.mode(linuxcnc.MODE_AUTO)
command.wait_complete()
command.program_open("part.ngc")
command.auto(linuxcnc.AUTO_RUN, 0)
until("running", lambda: status.interp_state != linuxcnc.INTERP_IDLE, 10)
until("idle", lambda: status.interp_state == linuxcnc.INTERP_IDLE, 300)
complaints()
if status.task_state != linuxcnc.STATE_ON:
    log.write("switched off before the end\n")
    sys.exit(1)
log.write("ended\n")
