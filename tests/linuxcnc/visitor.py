#!/usr/bin/python3
"""Visits places with both joints and notes what LinuxCNC compensates there.

Started by LinuxCNC as its DISPLAY. `places` has one position a line, in machine units, in the order in which they are
visited. `compensated` gets a line per place and joint: place, joint, command, backlash-corr, motor command minus command.
Its last line is `ended`, or else LinuxCNC did not come to the end.
"""

import sys
import time

import hal
import linuxcnc

command, status, errors = linuxcnc.command(), linuxcnc.stat(), linuxcnc.error_channel()
reader = hal.component("visitor")  # values can be read by a living component only
reader.ready()
log = open("operator.log", "w", buffering=1)
out = open("compensated", "w", buffering=1)


def until(what, condition, patience_s=20):
    end = time.monotonic() + patience_s
    while True:
        status.poll()
        while (message := errors.poll()) is not None:
            log.write(f"LinuxCNC: {message[1]}\n")
            if message[0] in (linuxcnc.OPERATOR_ERROR, linuxcnc.NML_ERROR):
                sys.exit(1)
        if condition():
            return
        if time.monotonic() > end:
            log.write(f"not {what}\n")
            sys.exit(1)
        time.sleep(0.005)


command.state(linuxcnc.STATE_ESTOP_RESET)
until("e-stop reset", lambda: status.task_state in (linuxcnc.STATE_ESTOP_RESET, linuxcnc.STATE_OFF))
command.state(linuxcnc.STATE_ON)
until("on", lambda: status.task_state == linuxcnc.STATE_ON)
command.mode(linuxcnc.MODE_MANUAL)
command.wait_complete()
command.teleop_enable(0)
command.wait_complete()
command.home(-1)
until("homed", lambda: status.homed[0] and status.homed[1])
command.mode(linuxcnc.MODE_MDI)
command.wait_complete()
command.mdi("G20 G90" if status.linear_units < 0.1 else "G21 G90")
command.wait_complete()


def settled():
    """The compensation is ramped: it is there when filter and table agree."""
    return status.inpos and status.interp_state == linuxcnc.INTERP_IDLE and all(
        abs(hal.get_value(f"joint.{j}.backlash-filt") - hal.get_value(f"joint.{j}.backlash-corr")) < 1e-12 for j in (0, 1)
    )


with open("places") as places:
    for place in (float(line) for line in places):
        command.mdi(f"G0 X{place:.9f} Z{place:.9f}")
        command.wait_complete()
        until(f"at {place}", lambda: settled() and abs(hal.get_value("joint.0.pos-cmd") - place) < 1e-6)
        for j in (0, 1):
            at, trim = hal.get_value(f"joint.{j}.pos-cmd"), hal.get_value(f"joint.{j}.backlash-corr")
            motor = hal.get_value(f"joint.{j}.motor-pos-cmd") - hal.get_value(f"joint.{j}.motor-offset")
            out.write(f"{place:.9f} {j} {at:.9f} {trim:.9f} {motor - at:.9f}\n")
out.write("ended\n")
