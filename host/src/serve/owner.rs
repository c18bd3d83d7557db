//! The one thread that owns the board's port. It does what the command line does, with the same [`perform`]; pages hand it one
//! thing to do at a time, and a terminal borrows the board (`link::loan`). A stop waits for nothing: it ends what is going on and is sent whatever the board says of itself.

mod aside;
mod words;

pub use aside::Aside;

use super::board::{Board, Doing, Ended};
use super::holder::{HeldError, Holder};
use super::series::{self, Failed, Task};
use super::tap::Tap;
use crate::link::bench::{Action, Experiment, Outcome, align, perform};
use crate::link::relay::{self, Lender};
use crate::link::{LinkError, Port, Returned, Session};
use crate::model::motor::Motor;
use crate::model::parameters::Flavour;
use serde_json::{Value, json};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tokio::sync::oneshot;
use twum_shared::message::{CaptureMode, Configuration};
use twum_shared::step::ConfigSpec;
use words::words_of;

/// A command or a stop is seen within this time while nothing is going on.
const SLICE: Duration = Duration::from_millis(5);
/// A port that is away is tried again this often.
const RETRY: Duration = Duration::from_millis(500);
/// A terminal that is done returns the board within this time: its next command waits for that.
const RETURNING: Duration = Duration::from_secs(1);
/// Every stream.
pub(super) const ALL_STREAMS: CaptureMode = CaptureMode { bits: true, edges: true, control: true };

/// The port as the owner uses it.
pub type OwnPort = Tap<Box<dyn Port>>;

/// How to reach the board, and what its recordings keep of its motor.
pub trait Bench: Send {
    /// Opens the port, over which `lender` lends the board to terminals.
    ///
    /// # Errors
    /// When it cannot be opened.
    fn open(&mut self, lender: Lender) -> Result<Box<dyn Port>, LinkError>;

    /// What a recording keeps of the motor of a board that says to be `chip` and runs with `used`.
    ///
    /// # Errors
    /// In a sentence, when the two do not go together.
    fn motor(&self, chip: &str, used: &Configuration) -> Result<String, String>;

    /// The readings of the motor to hold a controller against before the board is given it.
    fn readings(&self) -> Vec<(Motor, Flavour)>;
}

/// What a page or a terminal may ask for.
#[derive(Debug)]
pub enum Command {
    /// A run, recorded.
    Run {
        /// What to do.
        action: Action,
        /// What it is called.
        what: String,
        /// Where to record.
        recording: PathBuf,
    },
    /// Find the beginning of an encoder pulse.
    Align,
    /// Allow runs.
    Arm,
    /// Stop, and clear a latched fault.
    Clear,
    /// Give the board another configuration.
    Configure(Box<Configuration>),
    /// Make the runs of a series that are not made yet.
    Series(Box<Task>),
    /// Lend the board to a terminal, over this stream.
    Lend {
        /// The terminal's end of it is that of a program of the same user.
        stream: UnixStream,
        /// What for.
        what: String,
    },
}

type Answer = Result<Value, String>;

#[derive(Default)]
struct Desk {
    command: Option<(Command, oneshot::Sender<Answer>)>,
    is_busy: bool,
    /// Something beside the port goes on alone; whether it has been told to stop.
    aside: Option<bool>,
    stops: Vec<oneshot::Sender<Answer>>,
}

/// The way to the thread.
pub struct Owner {
    desk: Mutex<Desk>,
    board: Arc<Board>,
    holder: Arc<Holder>,
    /// Ends every wait of the session but those that stop the motor.
    stop: &'static AtomicBool,
    quit: AtomicBool,
}

impl Owner {
    /// Starts the thread.
    pub fn start(bench: Box<dyn Bench>, board: Arc<Board>, holder: Arc<Holder>) -> (Arc<Self>, JoinHandle<()>) {
        // A session keeps its flag for as long as the program lives; there is one owner a program.
        let stop = Box::leak(Box::new(AtomicBool::new(false)));
        let owner = Arc::new(Self { desk: Mutex::default(), board, holder, stop, quit: AtomicBool::new(false) });
        let thread = Arc::clone(&owner);
        let thread = std::thread::spawn(move || Thread { owner: thread, bench }.work());
        (owner, thread)
    }

    fn desk(&self) -> MutexGuard<'_, Desk> {
        self.desk.lock().expect("nothing panics while it holds the desk")
    }

    /// Hands over something to do; the answer comes when it is taken, or when it is done if that takes no time.
    ///
    /// # Errors
    /// When something else is going on.
    pub fn ask(&self, command: Command) -> Result<oneshot::Receiver<Answer>, String> {
        let mut desk = self.desk();
        self.is_free(&desk)?;
        let (sender, answer) = oneshot::channel();
        desk.command = Some((command, sender));
        Ok(answer)
    }

    /// Lets something beside the port go on alone: nothing is taken until it is dropped, and what stops the motor stops it.
    ///
    /// # Errors
    /// When something else is going on.
    pub fn set_aside(self: &Arc<Self>) -> Result<Aside, String> {
        let mut desk = self.desk();
        self.is_free(&desk)?;
        desk.aside = Some(false);
        Ok(Aside { owner: Arc::clone(self), ended: None })
    }

    /// Whether something beside the port goes on.
    pub fn has_aside(&self) -> bool {
        self.desk().aside.is_some()
    }

    fn is_free(&self, desk: &Desk) -> Result<(), String> {
        if desk.is_busy || desk.command.is_some() || desk.aside.is_some() || self.is_stopping() {
            return Err("something is going on: wait for its end, or stop it".to_owned());
        }
        Ok(())
    }

    /// Stops the motor; a latched fault stays. Answers when it has been seen to stand.
    pub fn stop(&self) -> oneshot::Receiver<Answer> {
        let (sender, answer) = oneshot::channel();
        let mut desk = self.desk();
        if let Some((_, asked)) = desk.command.take() {
            // Whoever asked may be gone.
            let _ = asked.send(Err("a stop came before it".to_owned()));
        }
        desk.aside = desk.aside.map(|_| true);
        desk.stops.push(sender);
        self.stop.store(true, Ordering::Relaxed);
        answer
    }

    /// Stops the motor and ends the thread.
    pub fn quit(&self) {
        let mut desk = self.desk();
        desk.aside = desk.aside.map(|_| true);
        self.quit.store(true, Ordering::Relaxed);
        self.stop.store(true, Ordering::Relaxed);
    }

    /// Lends the board to a terminal, while no page holds the motor and nothing is going on. Returns with the loan.
    fn lend(&self, stream: UnixStream, what: &str) -> Result<(), String> {
        let until = Instant::now() + RETURNING;
        while let Err(why) = self.holder.lend() {
            if why != HeldError::Lent || Instant::now() > until {
                return Err(why.to_string());
            }
            std::thread::sleep(SLICE);
        }
        let what = crate::input::printable(what);
        let lent = self
            .ask(Command::Lend { stream, what })
            .and_then(|answer| answer.blocking_recv().unwrap_or_else(|_| Err("the server is ending".to_owned())));
        // After a loan the thread has returned it.
        lent.map(|_| ()).inspect_err(|_| self.holder.is_returned())
    }

    fn is_stopping(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    fn has_to_quit(&self) -> bool {
        self.quit.load(Ordering::Relaxed)
    }

    fn take(&self) -> Option<(Command, oneshot::Sender<Answer>)> {
        let mut desk = self.desk();
        let taken = desk.command.take();
        desk.is_busy = taken.is_some();
        taken
    }

    /// Shown before whoever asked is told: one that is told finds it.
    fn begins(&self, doing: Doing, asked: oneshot::Sender<Answer>) {
        self.board.doing(Some(doing));
        // Whoever asked may be gone.
        let _ = asked.send(Ok(json!({ "accepted": true })));
    }

    /// Free and told as one: whoever is told of the end may ask for the next thing at once.
    fn is_free_again(&self, last: Last) {
        let mut desk = self.desk();
        desk.is_busy = false;
        if let Some(ended) = last.ended {
            self.board.ended(ended);
        }
        if let Some((asked, answer)) = last.answer {
            // Whoever asked may be gone.
            let _ = asked.send(answer);
        }
    }
}

struct Thread {
    owner: Arc<Owner>,
    bench: Box<dyn Bench>,
}

/// What is told when a command is over.
struct Last {
    ended: Option<Ended>,
    answer: Option<(oneshot::Sender<Answer>, Answer)>,
}

impl Last {
    fn of(ended: Ended) -> Self {
        Self { ended: Some(ended), answer: None }
    }
}

/// Why a session ended.
enum Over {
    Quit,
    Lost(LinkError),
}

impl Thread {
    fn work(&mut self) {
        while !self.owner.has_to_quit() {
            let over = match self.connect() {
                Ok(mut session) => {
                    self.owner.board.say(format!("{} answers", self.owner.board.state().port));
                    self.serve(&mut session)
                }
                Err(error) => Over::Lost(error),
            };
            if let Over::Lost(error) = over {
                self.owner.board.lost(&error.to_string());
                self.wait_for_the_port(&error.to_string());
            }
        }
    }

    fn open(&mut self) -> Result<OwnPort, LinkError> {
        let owner = Arc::downgrade(&self.owner);
        let lender: Lender = Arc::new(move |stream, what| match owner.upgrade() {
            Some(owner) => owner.lend(stream, what),
            None => Err("the server is ending".to_owned()),
        });
        Ok(Tap::new(self.bench.open(lender)?, Arc::clone(&self.owner.board)))
    }

    fn connect(&mut self) -> Result<Session<OwnPort>, LinkError> {
        let mut session = Session::new(self.open()?);
        session.interrupt_by(self.owner.stop);
        session.hello()?;
        let configuration = session.configuration()?;
        self.owner.board.connected(configuration);
        Ok(session)
    }

    /// Nothing can be done meanwhile, and whoever asks is told so.
    fn wait_for_the_port(&self, why: &str) {
        let until = Instant::now() + RETRY;
        while Instant::now() < until && !self.owner.has_to_quit() {
            if let Some((_, asked)) = self.owner.take() {
                self.owner.is_free_again(Last { ended: None, answer: Some((asked, Err(why.to_owned()))) });
            }
            if self.owner.is_stopping() {
                let unheard = format!(
                    "the board cannot be told: {why}. A board that hears nothing switches off by itself within its command \
                     timeout; look at the motor, and cut its power if it turns"
                );
                self.answer_stops(&Err(unheard));
            }
            std::thread::sleep(SLICE);
        }
    }

    fn answer_stops(&self, answer: &Answer) {
        let stops = {
            let mut desk = self.owner.desk();
            self.owner.stop.store(false, Ordering::Relaxed);
            std::mem::take(&mut desk.stops)
        };
        for stop in stops {
            let _ = stop.send(answer.clone());
        }
    }

    fn serve(&mut self, session: &mut Session<OwnPort>) -> Over {
        loop {
            if self.owner.is_stopping() {
                let halted = session.halt();
                self.answer_stops(&halted.as_ref().map(|()| json!({ "stopped": true })).map_err(ToString::to_string));
                if let Err(error @ LinkError::Lost { .. }) = halted {
                    return Over::Lost(error);
                }
            }
            if self.owner.has_to_quit() {
                return Over::Quit;
            }
            if let Some((command, asked)) = self.owner.take() {
                let is_loan = matches!(command, Command::Lend { .. });
                let (last, result) = self.obey(session, command, asked);
                if is_loan {
                    self.owner.holder.is_returned();
                }
                self.owner.is_free_again(last);
                if let Err(error @ LinkError::Lost { .. }) = result {
                    return Over::Lost(error);
                }
            }
            match session.next(SLICE) {
                Ok(_) | Err(LinkError::Interrupted) => {}
                Err(LinkError::Restarted) => self.owner.board.say(LinkError::Restarted.to_string()),
                Err(error) => return Over::Lost(error),
            }
        }
    }

    /// Does what is asked. The error is the link's, for whoever has to open it again; what is left to tell goes with it.
    fn obey(
        &mut self,
        session: &mut Session<OwnPort>,
        command: Command,
        asked: oneshot::Sender<Answer>,
    ) -> (Last, Result<(), LinkError>) {
        let result = match command {
            Command::Run { action, what, recording } => {
                return self.run(session, action, &what, recording, asked);
            }
            Command::Series(task) => {
                self.owner.begins(Doing::new(format!("experiment {}", task.name)), asked);
                return self.series(session, *task);
            }
            Command::Align => {
                self.owner.begins(Doing::new("aligning".to_owned()), asked);
                let result = session.let_go().and_then(|()| align(session));
                let words = result.as_ref().map_or_else(
                    |error| format!("not aligned: {error}"),
                    |()| {
                        "aligned: the rotor stands at the beginning of an encoder pulse, and counts as zero".to_owned()
                    },
                );
                return (Last::of(Ended { recording: None, ok: result.is_ok(), words }), result);
            }
            Command::Lend { stream, what } => {
                let (ended, result) = self.lend(session, &stream, &what);
                return (Last { ended, answer: Some((asked, Ok(json!({ "returned": true })))) }, result);
            }
            Command::Arm => session.arm(),
            Command::Clear => session.stop(),
            Command::Configure(configuration) => session.let_go().and_then(|()| session.configure(*configuration)),
        };
        let told = result.as_ref().map(|()| json!({ "done": true })).map_err(ToString::to_string);
        if let Err(words) = &told {
            self.owner.board.say(words.clone());
        }
        (Last { ended: None, answer: Some((asked, told)) }, result)
    }

    fn run(
        &mut self,
        session: &mut Session<OwnPort>,
        action: Action,
        what: &str,
        recording: PathBuf,
        asked: oneshot::Sender<Answer>,
    ) -> (Last, Result<(), LinkError>) {
        let name = recording.file_stem().map(|stem| stem.to_string_lossy().into_owned());
        let seconds = match &action {
            Action::Speed(run) => Some(f64::from(run.duration_ms) * 1e-3),
            Action::Track(run) => Some(f64::from(run.duration_ms) * 1e-3),
            Action::Watch(length) => Some(length.as_secs_f64()),
            Action::Driver(_) => None,
        };
        self.owner.begins(Doing { what: what.to_owned(), recording: name.clone(), seconds, elapsed_s: 0.0 }, asked);
        let used = self.owner.board.configuration().unwrap_or(Configuration::with_control(ConfigSpec::DEFAULT));
        let path = recording.clone();
        let result = self.record(session, used, action, recording);
        let (ok, words) = match &result {
            Ok(outcome) => words_of(outcome),
            Err(Failed::Link(error)) => (false, error.to_string()),
            Err(Failed::Other(words)) => (false, words.clone()),
        };
        let recording = name.filter(|_| path.exists());
        let last = Last::of(Ended { recording, ok, words: format!("{what}: {words}") });
        match result {
            Err(Failed::Link(error)) => (last, Err(error)),
            _ => (last, Ok(())),
        }
    }

    fn lend(
        &self,
        session: &mut Session<OwnPort>,
        stream: &UnixStream,
        what: &str,
    ) -> (Option<Ended>, Result<(), LinkError>) {
        if relay::lent(stream).is_err() {
            return (None, Ok(()));
        }
        let doing = Doing::new(format!("{what}, from a terminal, which records it if anybody does"));
        self.owner.board.doing(Some(doing));
        let result = session.lend(stream, || self.owner.is_stopping());
        let (ok, how) = match &result {
            Ok(Returned::ByTheOther) => (true, "ended".to_owned()),
            Ok(Returned::TakenBack) => (false, "stopped; it did not end by itself, and has lost the board".to_owned()),
            Ok(Returned::Behind) => (false, "it did not take what the board said, and has lost it; stopped".to_owned()),
            Err(error) => (false, error.to_string()),
        };
        let ended = Ended { recording: None, ok, words: format!("{what}, from a terminal: {how}") };
        (Some(ended), result.map(|_| ()))
    }

    /// Performs one run with a configuration, and records it.
    fn record(
        &mut self,
        session: &mut Session<OwnPort>,
        used: Configuration,
        action: Action,
        recording: PathBuf,
    ) -> Result<Outcome, Failed> {
        // A board that this session has armed takes no configuration.
        session.let_go()?;
        let chip = session.hello()?.chip;
        let motor = self.bench.motor(&chip, &used).map_err(Failed::Other)?;
        let experiment =
            Experiment { configuration: Some(used), capture: ALL_STREAMS, action, recording: Some(recording), motor };
        let mut reopen = || self.open();
        Ok(perform(session, &experiment, Some(&mut reopen), |_| {})?)
    }

    fn series(&mut self, session: &mut Session<OwnPort>, task: Task) -> (Last, Result<(), LinkError>) {
        let board = Arc::clone(&self.owner.board);
        let own = board.configuration().unwrap_or(Configuration::with_control(ConfigSpec::DEFAULT));
        let ended = series::make(&task, &board, own, &mut |used, action, recording, pause| {
            session.rest(pause)?;
            self.record(session, used, action, recording)
        });
        let restored = session.let_go().and_then(|()| session.configure(own));
        (Last::of(ended), restored)
    }
}

#[cfg(test)]
mod tests;
