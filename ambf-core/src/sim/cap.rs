/// How many sub-steps an iteration may do.
///
/// Simulated time that cannot be computed in time is lost anyway; what can be chosen is how long one iteration blocks
/// states and commands. While an iteration takes longer than the time it simulates, the cap comes down by a quarter at
/// a time, so that many small iterations replace few huge ones; when there is room again it rises by one at a time,
/// never above the world's limit.
#[derive(Debug, Clone)]
pub(super) struct SubStepCap {
    limit: u32,
    now: u32,
}

impl SubStepCap {
    pub fn new(limit: u32) -> Self {
        Self { limit, now: limit }
    }

    pub fn get(&self) -> u32 {
        self.now
    }

    /// Learns from an iteration that did `sub_steps` of `length` s in `cost` s.
    pub fn learn(&mut self, sub_steps: u32, length: f64, cost: f64) {
        let sub_steps = sub_steps.min(self.now);
        let simulated = f64::from(sub_steps) * length;
        if cost > simulated && sub_steps > 1 {
            self.now = (self.now * 3 / 4).max(1);
        } else if cost < 0.9 * simulated {
            self.now = (self.now + 1).min(self.limit);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Iterations of a loop in which a sub-step of 1 ms costs `cost` s; (iterations, sub-steps done) in `seconds`.
    fn run(cap: &mut SubStepCap, cost: f64, seconds: f64) -> (u32, u32) {
        let (mut wall, mut begun, mut iterations, mut done) = (0.0, 0, 0, 0);
        while wall < seconds {
            wall += 1e-6;
            let due = (wall / 0.001) as u32 - begun;
            begun += due;
            let steps = due.min(cap.get());
            let spent = (f64::from(steps) * cost).max(0.0001);
            cap.learn(due, 0.001, spent);
            wall += spent.max(0.001);
            iterations += 1;
            done += steps;
        }
        (iterations, done)
    }

    #[test]
    fn an_overloaded_loop_keeps_many_small_iterations_and_loses_no_more_time() {
        let mut cap = SubStepCap::new(50);
        let (iterations, done) = run(&mut cap, 0.0014, 10.0);
        assert!(iterations > 3000, "{iterations}");
        assert!(f64::from(done) > 0.95 * 10.0 / 0.0014, "{done}");
    }

    #[test]
    fn the_cap_comes_back_when_there_is_room() {
        let mut cap = SubStepCap::new(50);
        run(&mut cap, 0.0014, 2.0);
        assert!(cap.get() < 5);
        run(&mut cap, 0.0002, 2.0);
        assert_eq!(cap.get(), 50);
    }

    #[test]
    fn one_late_call_of_a_light_scene_changes_nothing() {
        let mut cap = SubStepCap::new(50);
        cap.learn(40, 0.001, 0.001);
        assert_eq!(cap.get(), 50);
        // Preempted: room for twice as many sub-steps as it had to do is left.
        cap.learn(2, 0.001, 0.01);
        assert!(cap.get() > 30);
    }
}
