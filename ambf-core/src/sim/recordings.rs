//! Beginning and ending recordings of a running simulation, from other threads.

use crossbeam_channel::{bounded, Receiver, Sender};

use super::models::ANSWER_TIMEOUT;
use super::session::{Recorder, StartError};
use super::Simulation;

/// Where a recording begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Beginning {
    /// Where the simulation is, which must be its start or directly after a reset.
    Here,
    /// There, or else with the next reset of the world that somebody asks for.
    NextReset,
    /// With a reset of the world that is done for it.
    Reset,
}

type Answer<T> = Sender<Result<T, StartError>>;

enum Request {
    Start(Box<Recorder>, Beginning, Answer<bool>),
    Stop(Answer<bool>),
}

/// Begins and ends recordings of a running simulation, from any thread. The simulation answers while it is paused or held,
/// too.
#[derive(Clone)]
pub struct Recordings(Sender<Request>);

/// Requests that may wait.
const REQUESTS: usize = 4;

impl Recordings {
    /// Records everything through `recorder`, from `beginning` on; whether it has begun, or waits for a reset.
    ///
    /// # Errors
    /// [`StartError`]; then nothing is recorded through it, and it is dropped.
    pub fn start(&self, recorder: Recorder, beginning: Beginning) -> Result<bool, StartError> {
        self.ask(|answer| Request::Start(Box::new(recorder), beginning, answer))
    }

    /// Records no more, and waits for no reset to begin; whether something was recorded.
    ///
    /// # Errors
    /// [`StartError::NoAnswer`].
    pub fn stop(&self) -> Result<bool, StartError> {
        self.ask(Request::Stop)
    }

    fn ask<T>(&self, request: impl FnOnce(Answer<T>) -> Request) -> Result<T, StartError> {
        let (answer, answered) = bounded(1);
        self.0.send_timeout(request(answer), ANSWER_TIMEOUT).map_err(|_| StartError::NoAnswer)?;
        answered.recv_timeout(ANSWER_TIMEOUT).unwrap_or(Err(StartError::NoAnswer))
    }
}

/// The physics thread's end.
#[derive(Default)]
pub(super) struct RecordingRequests {
    waiting: Option<Receiver<Request>>,
    /// Begins with the next reset of the world; with who waits for that.
    next: Option<(Box<Recorder>, Option<Answer<bool>>)>,
}

impl RecordingRequests {
    pub fn is_asked(&self) -> bool {
        self.waiting.as_ref().is_some_and(|waiting| !waiting.is_empty())
    }
}

impl Simulation {
    /// The handle through which other threads begin and end recordings. Replaces an earlier one.
    pub fn recordings(&mut self) -> Recordings {
        let (sender, waiting) = bounded(REQUESTS);
        self.recordings.waiting = Some(waiting);
        Recordings(sender)
    }

    /// Records everything through `recorder` from the next reset of the world on.
    ///
    /// # Errors
    /// [`StartError`], but [`StartError::Moved`].
    pub fn record_from_reset(&mut self, recorder: Recorder) -> Result<(), StartError> {
        self.check_recordable()?;
        if self.recordings.next.is_some() {
            return Err(StartError::Recorded);
        }
        self.recordings.next = Some((Box::new(recorder), None));
        Ok(())
    }

    /// Physics thread: does what was asked for.
    pub(super) fn serve_recordings(&mut self) {
        while let Some(Ok(request)) = self.recordings.waiting.as_ref().map(|waiting| waiting.try_recv()) {
            // Who no longer waits takes it that nothing is recorded: that is made true.
            match request {
                Request::Start(recorder, beginning, answer) => self.begin_asked(recorder, beginning, answer),
                Request::Stop(answer) => {
                    let waited = self.recordings.next.take();
                    if let Some((_, Some(waits))) = &waited {
                        let _ = waits.send(Err(StartError::Moved));
                    }
                    let _ = answer.send(Ok(self.stop_recording() || waited.is_some()));
                }
            }
        }
    }

    fn begin_asked(&mut self, recorder: Box<Recorder>, beginning: Beginning, answer: Answer<bool>) {
        let refused = match self.check_recordable() {
            _ if self.is_replaying() => Some(StartError::Replaying),
            _ if self.recordings.next.is_some() => Some(StartError::Recorded),
            checked => checked.err(),
        };
        if let Some(error) = refused {
            let _ = answer.send(Err(error));
            return;
        }
        match beginning {
            Beginning::NextReset if !self.is_at_start() => {
                if answer.send(Ok(false)).is_ok() {
                    self.recordings.next = Some((recorder, None));
                }
            }
            Beginning::Here | Beginning::NextReset => {
                let begun = self.start_recording(*recorder);
                self.answer_begun(begun, &answer);
            }
            Beginning::Reset => {
                self.recordings.next = Some((recorder, Some(answer)));
                match &self.link {
                    // Done as all others: who rests between the halves of an iteration makes the first one anew.
                    Some(link) => link.hub.request_world_reset(),
                    None => {
                        self.reset_world();
                        self.begin_waiting_recording();
                    }
                }
            }
        }
    }

    /// Says what became of a start; one that nobody waits for is undone.
    fn answer_begun(&mut self, begun: Result<(), StartError>, answer: &Answer<bool>) {
        let has_begun = begun.is_ok();
        if answer.send(begun.map(|()| true)).is_err() && has_begun {
            self.stop_recording();
        }
    }

    /// Begins the recording that waits for a reset of the world, which was done; nothing without one.
    pub(super) fn begin_waiting_recording(&mut self) {
        let Some((recorder, waits)) = self.recordings.next.take() else { return };
        let begun = self.start_recording(*recorder);
        match (begun, waits) {
            (begun, Some(waits)) => self.answer_begun(begun, &waits),
            (Ok(()), None) => self.notices.push("the recording begins, with this reset".into()),
            (Err(error), None) => self.notices.push(format!("the recording does not begin with this reset: {error}")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::recorder;
    use crate::sim::shipped::simulation;
    use crate::sim::Entry;

    /// Asks in another thread, and lets the simulation answer.
    fn asked<T: Send>(simulation: &mut Simulation, ask: impl FnOnce() -> T + Send) -> T {
        std::thread::scope(|scope| {
            let asking = scope.spawn(ask);
            while !asking.is_finished() {
                simulation.serve_recordings();
                let (_, outcome) = simulation.do_requested_resets_at_rest();
                outcome.expect("sound");
                std::thread::yield_now();
            }
            asking.join().expect("no panic")
        })
    }

    #[test]
    fn a_recording_begins_where_the_state_is_known_or_with_a_reset() {
        let mut simulation = simulation("pendulum.yaml", false);
        simulation.connect();
        let recordings = simulation.recordings();
        (0..5).for_each(|_| simulation.update(0.001).expect("sound"));
        let (refused, _) = recorder(false);
        assert_eq!(asked(&mut simulation, || recordings.start(refused, Beginning::Here)), Err(StartError::Moved));
        let (recorder_of, mut tap) = recorder(false);
        assert_eq!(asked(&mut simulation, || recordings.start(recorder_of, Beginning::Reset)), Ok(true));
        let (refused, _) = recorder(false);
        assert_eq!(
            asked(&mut simulation, || recordings.start(refused, Beginning::NextReset)),
            Err(StartError::Recorded)
        );
        simulation.update(0.001).expect("sound");
        assert_eq!(asked(&mut simulation, || recordings.stop()), Ok(true));
        assert_eq!(asked(&mut simulation, || recordings.stop()), Ok(false));
        let mut entries = Vec::new();
        tap.drain(|bytes| entries.push(Entry::read(bytes).expect("whole")));
        assert!(tap.is_last());
        // The update that was under way is made anew: it is the first of the recording.
        assert!(matches!(entries[0], Entry::Start { iteration: 4, .. }), "{entries:?}");
        assert!(matches!(entries[1], Entry::Update { iteration: 5, .. }), "{entries:?}");
        assert!(matches!(entries[2], Entry::Update { iteration: 6, .. }), "{entries:?}");
        assert_eq!(entries.len(), 3);
    }

    #[test]
    fn a_start_that_nobody_waits_for_is_undone() {
        let mut simulation = simulation("pendulum.yaml", false);
        let hub = simulation.connect();
        let recordings = simulation.recordings();
        let ask = |beginning| {
            let (recorder, _) = recorder(false);
            // The receiver is dropped, as after the time for an answer.
            let request = Request::Start(Box::new(recorder), beginning, bounded(1).0);
            recordings.0.send(request).expect("there is room");
        };
        ask(Beginning::Here);
        simulation.serve_recordings();
        assert!(!simulation.is_recorded());
        (0..5).for_each(|_| simulation.update(0.001).expect("sound"));
        for beginning in [Beginning::NextReset, Beginning::Reset] {
            ask(beginning);
            simulation.serve_recordings();
            hub.request_world_reset();
            simulation.do_requested_resets_at_rest().1.expect("sound");
            assert!(!simulation.is_recorded(), "{beginning:?}");
            (0..5).for_each(|_| simulation.update(0.001).expect("sound"));
        }
        // Somebody else's goes on.
        let (others, _tap) = recorder(false);
        assert_eq!(asked(&mut simulation, || recordings.start(others, Beginning::Reset)), Ok(true));
        ask(Beginning::Here);
        simulation.serve_recordings();
        assert!(simulation.is_recorded());
    }

    #[test]
    fn one_that_waits_begins_with_the_reset_of_somebody_else() {
        let mut simulation = simulation("pendulum.yaml", false);
        let hub = simulation.connect();
        let recordings = simulation.recordings();
        (0..5).for_each(|_| simulation.update(0.001).expect("sound"));
        let (recorder_of, _tap) = recorder(false);
        assert_eq!(asked(&mut simulation, || recordings.start(recorder_of, Beginning::NextReset)), Ok(false));
        assert!(!simulation.is_recorded());
        hub.request_body_reset();
        simulation.do_requested_resets_at_rest().1.expect("sound");
        assert!(!simulation.is_recorded(), "a reset of the bodies is none of the world");
        hub.request_world_reset();
        simulation.do_requested_resets_at_rest().1.expect("sound");
        assert!(simulation.is_recorded());
        assert!(simulation.take_notices().iter().any(|notice| notice.contains("begins")));
        // What a reset keeps is refused at once.
        assert_eq!(asked(&mut simulation, || recordings.stop()), Ok(true));
        simulation.switch_gravity(false);
        let (refused, _) = recorder(false);
        assert_eq!(
            asked(&mut simulation, || recordings.start(refused, Beginning::NextReset)),
            Err(StartError::Changed)
        );
    }
}
