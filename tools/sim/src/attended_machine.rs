//! A machine that needs attention in every period of its controller.
//! Errors move its tool, the tool cuts, or an operator presses a button.

use crate::machine::{SERVO_NS, SimMachine};

/// A machine, and what happens at it.
pub trait AttendedMachine {
    /// The attended machine.
    fn machine(&self) -> &SimMachine;

    /// The attended machine, to be changed.
    fn machine_mut(&mut self) -> &mut SimMachine;

    /// Called after each period of the controller, before the next one is commanded.
    fn tick(&mut self);

    /// Called when lines may have changed.
    fn changed(&mut self) {}

    /// Runs the machine until `t_ns`, ns of its own clock, with a tick in every period.
    fn run_to(&mut self, t_ns: u64) {
        let mut now_ns = self.machine().now_ns();
        while now_ns / SERVO_NS < t_ns / SERVO_NS {
            now_ns = (now_ns / SERVO_NS + 1) * SERVO_NS;
            self.machine_mut().run_to(now_ns);
            self.tick();
        }
        self.machine_mut().run_to(t_ns);
    }
}
