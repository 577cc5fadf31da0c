use std::sync::atomic::{AtomicU64, Ordering};

use crossbeam_utils::atomic::AtomicCell;

use super::{Command, WATCHDOG_TIMEOUT};

struct Mail<C> {
    command: C,
    posted_ns: u64,
    /// The order of steps it belongs to; 0: none.
    order: u64,
}

impl<C: Command> Mail<C> {
    fn empty() -> Box<Self> {
        Box::new(Self { command: C::default(), posted_ns: 0, order: 0 })
    }
}

/// One place for a command that waits, and one for a box that is not needed any more.
struct Tray<C> {
    incoming: AtomicCell<Option<Box<Mail<C>>>>,
    returned: AtomicCell<Option<Box<Mail<C>>>>,
}

impl<C: Command> Tray<C> {
    fn new() -> Self {
        Self { incoming: AtomicCell::new(None), returned: AtomicCell::new(None) }
    }

    fn post(&self, command: &C, posted_ns: u64, order: u64) {
        let mut mail = self.returned.take().unwrap_or_else(Mail::empty);
        mail.command.copy_from(command);
        mail.posted_ns = posted_ns;
        mail.order = order;
        if let Some(unread) = self.incoming.swap(Some(mail)) {
            self.returned.store(Some(unread));
        }
    }

    /// What waits, and is not wanted any more.
    fn discard(&self) {
        if let Some(mail) = self.incoming.take() {
            self.returned.store(Some(mail));
        }
    }
}

/// The newest command of one object, handed from any thread to the physics thread without a lock.
///
/// Commands of [orders of steps](super::Hub::step) wait apart from all others: while an order runs, nothing replaces
/// what it commands, however late it was delivered.
///
/// Boxes circulate: the physics thread gives the one it has finished with back to the senders, so that in steady state
/// neither side allocates, and the physics thread never frees.
pub struct Mailbox<C> {
    others: Tray<C>,
    ordered: Tray<C>,
    last_post_ns: AtomicU64,
}

impl<C: Command> Default for Mailbox<C> {
    fn default() -> Self {
        Self { others: Tray::new(), ordered: Tray::new(), last_post_ns: AtomicU64::new(0) }
    }
}

impl<C: Command> Mailbox<C> {
    /// Leaves `command` for the physics thread; one that still waits is replaced. `now_ns` is the hub's clock, ns.
    pub fn post(&self, command: &C, now_ns: u64) {
        self.last_post_ns.store(now_ns, Ordering::Release);
        self.others.post(command, now_ns, 0);
    }

    /// [`post`](Self::post) for the order of steps with the number `order`, which is not 0.
    pub fn post_ordered(&self, command: &C, now_ns: u64, order: u64) {
        self.last_post_ns.store(now_ns, Ordering::Release);
        self.ordered.post(command, now_ns, order);
    }

    /// Time of the latest post on the hub's clock, ns; 0 before the first.
    pub fn last_post_ns(&self) -> u64 {
        self.last_post_ns.load(Ordering::Acquire)
    }

    /// Whether a command was posted within the watchdog's time before `now_ns`.
    pub fn is_live(&self, now_ns: u64) -> bool {
        let last = self.last_post_ns();
        last != 0 && now_ns.saturating_sub(last) <= WATCHDOG_TIMEOUT.as_nanos() as u64
    }
}

/// The physics thread's end of a [`Mailbox`]: the command in force.
pub struct Inbox<C> {
    current: Box<Mail<C>>,
    watched: bool,
}

impl<C: Command> Default for Inbox<C> {
    fn default() -> Self {
        Self { current: Mail::empty(), watched: false }
    }
}

impl<C: Command + Clone> Inbox<C> {
    /// The same command in force, as if it had come `later_ns` later.
    pub fn later(&self, later_ns: u64) -> Self {
        let Mail { command, posted_ns, order } = &*self.current;
        let mail = Mail { command: command.clone(), posted_ns: posted_ns.saturating_add(later_ns), order: *order };
        Self { current: Box::new(mail), watched: self.watched }
    }
}

impl<C: Command> Inbox<C> {
    /// Takes what waits in `mailbox`; true when there is a command that was not there before. `order` is the number of
    /// the order of steps that runs, 0 while none does: while it runs, its own commands stay in force, and what else
    /// comes for the same object is dropped.
    pub fn fetch(&mut self, mailbox: &Mailbox<C>, order: u64) -> bool {
        let Mailbox { others, ordered, .. } = mailbox;
        let ordered_mail = ordered.incoming.take();
        let (tray, mail) = if ordered_mail.is_some() {
            others.discard();
            (ordered, ordered_mail)
        } else if order != 0 && self.current.order == order {
            others.discard();
            (others, None)
        } else {
            (others, others.incoming.take())
        };
        let Some(mail) = mail else { return false };
        let old = std::mem::replace(&mut self.current, mail);
        // Senders empty `returned` before they post, so this frees only when two of them race.
        tray.returned.store(Some(old));
        self.watched = true;
        true
    }

    /// Clears the command once when nothing was posted for the watchdog's time before `now_ns`; true when it did.
    pub fn check_watchdog(&mut self, now_ns: u64) -> bool {
        let expired =
            self.watched && now_ns.saturating_sub(self.current.posted_ns) > WATCHDOG_TIMEOUT.as_nanos() as u64;
        if expired {
            self.current.command.expire();
            self.watched = false;
        }
        expired
    }

    /// Forgets the command in force unless it was posted at `time_ns` or later; whether it did.
    pub fn forget_before(&mut self, time_ns: u64) -> bool {
        let is_past = self.current.posted_ns < time_ns;
        if is_past {
            self.watched = false;
            self.current.command.copy_from(&C::default());
            (self.current.posted_ns, self.current.order) = (0, 0);
        }
        is_past
    }

    /// The command in force.
    pub fn command(&self) -> &C {
        &self.current.command
    }

    /// The command in force, to be set without a mailbox (batch runs, tests). No watchdog follows it.
    pub fn command_mut(&mut self) -> &mut C {
        self.watched = false;
        &mut self.current.command
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comm::RigidBodyCommand;
    use nalgebra::Vector3;

    fn push(x: f64) -> RigidBodyCommand {
        RigidBodyCommand { force: Vector3::new(x, 0.0, 0.0), ..Default::default() }
    }

    #[test]
    fn the_newest_command_wins_and_is_taken_once() {
        let mailbox = Mailbox::default();
        let mut inbox = Inbox::default();
        mailbox.post(&push(1.0), 1);
        mailbox.post(&push(2.0), 2);
        assert!(inbox.fetch(&mailbox, 0));
        assert_eq!(inbox.command().force.x, 2.0);
        assert!(!inbox.fetch(&mailbox, 0));
        assert_eq!(inbox.command().force.x, 2.0, "it stays in force");
    }

    #[test]
    fn nothing_replaces_the_commands_of_the_order_that_runs() {
        let (mailbox, mut inbox): (Mailbox<RigidBodyCommand>, Inbox<RigidBodyCommand>) =
            (Mailbox::default(), Inbox::default());
        let mut in_force = |order, fetched: bool| {
            assert_eq!(inbox.fetch(&mailbox, order), fetched);
            inbox.command().force.x
        };
        mailbox.post(&push(1.0), 1);
        mailbox.post_ordered(&push(2.0), 2, 7);
        mailbox.post(&push(3.0), 3);
        assert_eq!(in_force(7, true), 2.0, "neither what came before nor what came after");
        mailbox.post(&push(4.0), 4);
        assert_eq!(in_force(7, false), 2.0, "nor what comes while it runs");
        assert_eq!(in_force(0, false), 2.0, "that is dropped for good");
        mailbox.post(&push(5.0), 5);
        assert_eq!(in_force(8, true), 5.0, "an order that does not command the object leaves it to others");
        mailbox.post_ordered(&push(6.0), 6, 9);
        assert_eq!(in_force(9, true), 6.0);
        mailbox.post(&push(7.0), 7);
        assert_eq!(in_force(0, true), 7.0, "as does one that is done");
    }

    #[test]
    fn the_watchdog_clears_once_and_a_new_command_arms_it_again() {
        let mailbox = Mailbox::default();
        let mut inbox = Inbox::default();
        assert!(!inbox.check_watchdog(u64::MAX), "nothing to clear before the first command");
        mailbox.post(&push(1.0), 1_000);
        inbox.fetch(&mailbox, 0);
        assert!(!inbox.check_watchdog(500_000_000));
        assert!(inbox.check_watchdog(500_001_001));
        assert_eq!(inbox.command().force.x, 0.0);
        assert!(!inbox.check_watchdog(900_000_000), "one shot");
        mailbox.post(&push(3.0), 1_000_000_000);
        inbox.fetch(&mailbox, 0);
        assert!(!inbox.check_watchdog(1_000_000_001));
        assert_eq!(inbox.command().force.x, 3.0);
    }

    #[test]
    fn a_command_that_waited_too_long_expires_before_it_acts() {
        let mailbox = Mailbox::default();
        let mut inbox = Inbox::default();
        mailbox.post(&push(1.0), 1);
        inbox.fetch(&mailbox, 0);
        assert!(inbox.check_watchdog(2_000_000_000));
        assert_eq!(inbox.command().force.x, 0.0);
    }

    #[test]
    fn many_senders_lose_no_last_word() {
        let mailbox = Mailbox::default();
        let mut inbox: Inbox<RigidBodyCommand> = Inbox::default();
        std::thread::scope(|scope| {
            for sender in 0..4 {
                let mailbox = &mailbox;
                scope.spawn(move || (0..2000).for_each(|i| mailbox.post(&push(f64::from(sender * 10_000 + i)), 1)));
            }
            for _ in 0..5000 {
                inbox.fetch(&mailbox, 0);
            }
        });
        mailbox.post(&push(-1.0), 2);
        assert!(inbox.fetch(&mailbox, 0));
        assert_eq!(inbox.command().force.x, -1.0);
    }
}
