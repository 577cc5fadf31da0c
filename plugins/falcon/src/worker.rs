use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::Arc;
use std::time::{Duration, Instant};

use ambf_device::{DeviceLog, DeviceSample};
use triple_buffer::{Input, Output};

use crate::firmware::{Firmware, FirmwareError};
use crate::link::{Answer, Link};
use crate::motion::{Motion, Wanted};
use crate::settings::Config;
use crate::transport::{Bus, TransportError};

/// Without a reply for so long the device is sent forces of zero.
const REPLY_TIMEOUT: Duration = Duration::from_millis(20);
/// Without a reply for so long it is closed and opened again.
const SILENCE: Duration = Duration::from_millis(200);
/// A device that is gone is looked for so often.
const RETRY: Duration = Duration::from_secs(1);
/// Attempts to get the firmware into a device before the host gets an error.
const UPLOADS: u32 = 10;

/// What a device is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum State {
    /// It is not there, or does not answer.
    Away,
    /// It gets its firmware.
    Loading,
    /// It waits for its user to move the grip over the marks of its encoders.
    Homing,
    /// It can be used.
    Ready,
}

/// What is known of a device.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Status {
    /// The newest sample.
    pub sample: DeviceSample,
    /// What it is doing.
    pub state: State,
    /// Encoders as the device says, counts.
    pub encoders: [i16; 3],
    /// Which encoders have passed their marks.
    pub homed: [bool; 3],
    /// Replies since it was opened.
    pub exchanges: u64,
}

impl Status {
    /// Nothing is known yet.
    pub(crate) fn none(now: Instant) -> Self {
        let sample = DeviceSample::none(now);
        Self { sample, state: State::Away, encoders: [0; 3], homed: [false; 3], exchanges: 0 }
    }
}

/// Exchanges packets with one device at full speed, and finds it again when it was away. Has no thread of its own:
/// [`step`](Self::step) is called again and again.
pub(crate) struct Worker {
    bus: Arc<dyn Bus>,
    identity: String,
    config: Config,
    log: DeviceLog,
    said: String,
    stop: Arc<AtomicBool>,
    wanted: Output<Wanted>,
    published: Input<Status>,
    status: Status,
    motion: Motion,
    link: Option<Link>,
    last_reply: Instant,
    retry_at: Instant,
    failed_uploads: u32,
}

impl Worker {
    pub fn new(
        bus: Arc<dyn Bus>,
        identity: &str,
        config: Config,
        log: DeviceLog,
        stop: Arc<AtomicBool>,
        wanted: Output<Wanted>,
        published: Input<Status>,
    ) -> Self {
        let now = bus.now();
        let motion = Motion::new(config.z0, now);
        Self {
            bus,
            identity: identity.to_owned(),
            config,
            log,
            said: String::new(),
            stop,
            wanted,
            published,
            status: Status::none(now),
            motion,
            link: None,
            last_reply: now,
            retry_at: now,
            failed_uploads: 0,
        }
    }

    /// Opens the device for the first time. One that waits for its firmware gets it in the steps that follow, if there
    /// is any.
    pub fn begin(&mut self) -> Result<(), Problem> {
        let mut link = Link::open(&self.bus, &self.identity, self.config.event_character)?;
        if link.is_running(&|| false)? {
            self.connected(link);
        } else if self.config.firmware.is_none() {
            return Err(Problem::NeedsFirmware);
        }
        Ok(())
    }

    pub fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Sends zero forces and closes the device.
    pub fn end(&mut self) {
        self.link = None;
        self.leave(State::Away);
    }

    /// One exchange, or one look for a device that is away.
    ///
    /// # Errors
    /// When there is no point in going on.
    pub fn step(&mut self) -> Result<(), Problem> {
        match self.link.take() {
            Some(link) => self.exchange(link),
            None => return self.connect(),
        }
        Ok(())
    }

    fn exchange(&mut self, mut link: Link) {
        let command = self.motion.command(self.wanted.read(), self.bus.now());
        let deadline = self.bus.now() + REPLY_TIMEOUT;
        let answer = link.command(&command).and_then(|()| link.answer(deadline));
        let now = self.bus.now();
        match answer {
            Ok(Answer::Reply(reply)) => {
                self.last_reply = now;
                self.motion.reply(&reply, now);
                self.status.exchanges += 1;
                (self.status.encoders, self.status.homed) = (reply.encoders, reply.homed);
                self.enter(if self.motion.is_homed() { State::Ready } else { State::Homing });
            }
            Ok(Answer::Damaged) if now < self.last_reply + REPLY_TIMEOUT => {}
            Ok(Answer::Damaged | Answer::Silence) | Err(TransportError::TimedOut) => self.motion.silent(),
            Err(error) => return self.lost(link, &error.to_string(), now + RETRY),
        }
        if now >= self.last_reply + SILENCE {
            return self.lost(link, "it does not answer", now);
        }
        self.link = Some(link);
        self.publish();
    }

    fn lost(&mut self, link: Link, why: &str, retry_at: Instant) {
        // Forces of zero, if the device still answers.
        drop(link);
        self.say(format!("is lost: {why}. It is looked for until it is back"));
        self.retry_at = retry_at;
        self.leave(State::Away);
    }

    fn connect(&mut self) -> Result<(), Problem> {
        let now = self.bus.now();
        if now < self.retry_at {
            self.bus.wait(self.retry_at - now);
            return Ok(());
        }
        let stop = Arc::clone(&self.stop);
        let stopped = || stop.load(Ordering::Relaxed);
        let attempt = Link::open(&self.bus, &self.identity, self.config.event_character)
            .and_then(|mut link| link.is_running(&stopped).map(|runs| (link, runs)));
        let (mut link, runs) = match attempt {
            Ok(found) => found,
            Err(error) => {
                self.say(format!("can't be used: {error}"));
                self.retry_at = self.bus.now() + RETRY;
                return Ok(());
            }
        };
        if runs {
            self.connected(link);
            return Ok(());
        }
        if stopped() {
            return Ok(());
        }
        let Some(firmware) = self.config.firmware.clone() else { return Err(Problem::NeedsFirmware) };
        self.say(format!("gets its firmware, {} bytes", firmware.len()));
        self.leave(State::Loading);
        match self.upload(&firmware, &mut link, &stopped) {
            Ok(()) => self.connected(link),
            Err(FirmwareError::Stopped) => {}
            Err(error) => {
                self.failed_uploads += 1;
                if self.failed_uploads >= UPLOADS {
                    return Err(Problem::Upload(error));
                }
                // Opened again it starts from the beginning, at once unless the device is gone.
                self.retry_at = match error {
                    FirmwareError::Transport(_) => self.bus.now() + RETRY,
                    _ => self.bus.now(),
                };
            }
        }
        Ok(())
    }

    fn upload(&self, firmware: &Firmware, link: &mut Link, stopped: &dyn Fn() -> bool) -> Result<(), FirmwareError> {
        firmware.upload(&*self.bus, link, stopped)?;
        link.normal_mode(self.config.event_character)?;
        match link.is_running(stopped)? {
            true => Ok(()),
            false if stopped() => Err(FirmwareError::Stopped),
            false => {
                Err(FirmwareError::Loader("has all of the firmware, which does not start: is the file the right one?"))
            }
        }
    }

    fn connected(&mut self, link: Link) {
        self.link = Some(link);
        self.failed_uploads = 0;
        self.last_reply = self.bus.now();
        self.said.clear();
    }

    /// The device is in a state in which it has no pose.
    fn leave(&mut self, state: State) {
        self.motion.away();
        self.status.homed = [false; 3];
        self.status.state = state;
        self.publish();
    }

    fn enter(&mut self, state: State) {
        if self.status.state == state {
            return;
        }
        self.status.state = state;
        if state == State::Homing {
            self.say("waits for homing: pull the grip all the way out, then push it all the way in");
        } else {
            self.say("is ready");
        }
    }

    fn publish(&mut self) {
        self.status.sample = *self.motion.sample();
        self.published.write(self.status);
    }

    /// Says a sentence about the device, unless it was the last one too.
    fn say(&mut self, sentence: impl Into<String>) {
        let sentence = sentence.into();
        if sentence != self.said {
            self.log.say(format!("Falcon {}: {sentence}", self.identity));
            self.said = sentence;
        }
    }
}

/// Why a device can't be used for now.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(crate) enum Problem {
    #[error(
        "its firmware does not run, as after each time it is switched on, and none is given: write `driver settings: {{firmware: nvent_firmware.bin}}`; \
         the file is part of Novint's SDK and of libnifalcon (docs/falcon.md)"
    )]
    NeedsFirmware,
    #[error("{UPLOADS} attempts to give it its firmware failed, at last so: {0}")]
    Upload(FirmwareError),
    #[error(transparent)]
    Transport(#[from] TransportError),
}

#[cfg(test)]
mod tests;
