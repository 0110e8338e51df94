//! A machine with something to do in every period of its controller.
//! Errors move its tool, the tool cuts, or an operator presses a button.

use crate::machine::{SERVO_NS, SimMachine};

/// The machine and what goes on at it.
pub trait Attended {
    /// The machine that is attended.
    fn machine(&self) -> &SimMachine;

    /// The machine, to be attended to.
    fn machine_mut(&mut self) -> &mut SimMachine;

    /// A period of the controller is over; it has not commanded the next one yet.
    fn tick(&mut self);

    /// Lines may have changed.
    fn changed(&mut self) {}

    /// Runs the machine until `t_ns`, ns of its own clock, with what is due meanwhile.
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
