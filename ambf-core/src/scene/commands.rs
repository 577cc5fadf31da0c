//! Commands in force for objects, and the one place where they are executed.

use std::any::Any;

use super::Scene;
use crate::comm::{Channel, Command, Inbox};

/// Commands in force for one object.
pub(crate) trait Commands: Send + Sync {
    /// The same commands, as if they had come `by` ns later.
    fn later(&self, by: u64) -> Box<dyn Commands>;

    /// Takes what waits in `channel` while the order of steps with the number `order` runs, as [`Inbox::fetch`]; true
    /// when there is a command to execute from now on. Sentences about what cannot be done go to `notices`.
    fn fetch(&mut self, channel: &Channel, order: u64, scene: &mut Scene, notices: &mut Vec<String>) -> bool;

    /// Forgets the command in force unless it was posted at `time_ns` or later; whether it did.
    fn forget_before(&mut self, time_ns: u64) -> bool;

    /// Executes the command in force, unless its watchdog has expired before `now_ns`.
    fn execute(&mut self, now_ns: u64, scene: &mut Scene, notices: &mut Vec<String>);

    /// The [`Inbox`] of what is executed.
    fn inbox(&mut self) -> &mut dyn Any;

    /// The [`Inbox`] of parameters that were set by the latest [`fetch`](Self::fetch), if any were.
    fn new_parameters(&mut self) -> Option<&mut dyn Any> {
        None
    }
}

/// Commands `C` of the object `id`.
pub(super) struct Commanded<I, C> {
    pub id: I,
    pub execute: fn(&mut Scene, I, &C, &mut Vec<String>),
    pub inbox: Inbox<C>,
}

impl<I, C: Command> Commanded<I, C> {
    /// None yet.
    pub fn new(id: I, execute: fn(&mut Scene, I, &C, &mut Vec<String>)) -> Box<Self> {
        Box::new(Self { id, execute, inbox: Inbox::default() })
    }
}

impl<I, C> Commands for Commanded<I, C>
where
    I: Copy + Send + Sync + 'static,
    C: Command + Clone + Sync + 'static,
{
    fn later(&self, by: u64) -> Box<dyn Commands> {
        Box::new(Self { inbox: self.inbox.later(by), ..*self })
    }

    fn fetch(&mut self, channel: &Channel, order: u64, _scene: &mut Scene, _notices: &mut Vec<String>) -> bool {
        self.inbox.fetch(C::mailbox(channel), order)
    }

    fn forget_before(&mut self, time_ns: u64) -> bool {
        self.inbox.forget_before(time_ns)
    }

    fn execute(&mut self, now_ns: u64, scene: &mut Scene, notices: &mut Vec<String>) {
        self.inbox.check_watchdog(now_ns);
        (self.execute)(scene, self.id, self.inbox.command(), notices);
    }

    fn inbox(&mut self) -> &mut dyn Any {
        &mut self.inbox
    }
}

/// [`Commanded`], and parameters `P` that stay in force for good.
pub(super) struct WithParameters<I, C, P> {
    pub commands: Commanded<I, C>,
    /// A sentence when something that the parameters name is not found.
    pub set: fn(&mut Scene, I, &P) -> Result<(), String>,
    pub parameters: Inbox<P>,
    /// The parameters came with the latest fetch.
    pub is_new: bool,
}

impl<I, C, P> Commands for WithParameters<I, C, P>
where
    I: Copy + Send + Sync + 'static,
    C: Command + Clone + Sync + 'static,
    P: Command + Clone + Sync + 'static,
{
    fn later(&self, by: u64) -> Box<dyn Commands> {
        let commands = Commanded { inbox: self.commands.inbox.later(by), ..self.commands };
        Box::new(Self { commands, parameters: self.parameters.later(by), ..*self })
    }

    fn fetch(&mut self, channel: &Channel, order: u64, scene: &mut Scene, notices: &mut Vec<String>) -> bool {
        self.is_new = self.parameters.fetch(P::mailbox(channel), order);
        if self.is_new {
            notices.extend((self.set)(scene, self.commands.id, self.parameters.command()).err());
        }
        self.commands.fetch(channel, order, scene, notices)
    }

    fn forget_before(&mut self, time_ns: u64) -> bool {
        self.commands.forget_before(time_ns)
    }

    fn execute(&mut self, now_ns: u64, scene: &mut Scene, notices: &mut Vec<String>) {
        self.commands.execute(now_ns, scene, notices);
    }

    fn inbox(&mut self) -> &mut dyn Any {
        self.commands.inbox()
    }

    fn new_parameters(&mut self) -> Option<&mut dyn Any> {
        self.is_new.then_some(&mut self.parameters as &mut dyn Any)
    }
}
