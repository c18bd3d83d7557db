//! `twum live`.

use super::connect::{ALL_STREAMS, ConnectArgs, INTERRUPTED, RecordArgs, catch_interrupts};
use anyhow::{Context, Result, bail};
use crossterm::event::{self, Event, KeyCode};
use ratatui::backend::TestBackend;
use ratatui::{DefaultTerminal, Terminal};
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, TryRecvError, sync_channel};
use std::thread;
use std::time::Duration;
use twum_host::link::Received;
use twum_host::link::bench::{Action, Experiment, Outcome};
use twum_host::link::relay::{self, Watching};
use twum_host::live::{LiveServer, draw};
use twum_host::record::decode::{Decoder, Item, LinkStatistics};
use twum_host::record::live::LiveView;
use twum_host::record::store::Ending;

/// The screen is drawn this often.
const DRAW_EVERY: Duration = Duration::from_millis(100);
/// Pieces taken from another program between two drawings.
const PIECES: usize = 256;
/// Messages on their way to the screen; what does not fit is not shown, and never waited for.
const WAITING: usize = 4096;

/// Arguments of `twum live`.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
To watch a run, follow the recording it makes, or its board through the program that holds the port:

  twum track --port /dev/ttyUSB0 --out sine.mcap      (in one terminal)
  twum live sine.mcap                                 (in another)
  twum live --port /dev/ttyUSB0                       (in another)

Neither can slow the run. Without a run, watch the board itself, recording or not:

  twum live --port /dev/ttyUSB0 --out idle.mcap

Keys: q quits.

With --foxglove the same values are served to Foxglove (\"Open connection\", \"Foxglove WebSocket\") on this machine only:

  twum live sine.mcap --foxglove                      ws://127.0.0.1:8765
  twum live sine.mcap --foxglove=9000 > /dev/null     without the screen, until Ctrl-C")]
pub struct Args {
    /// Recording to follow while it is made
    recording: Option<PathBuf>,
    #[command(flatten)]
    connect: ConnectArgs,
    #[command(flatten)]
    record: RecordArgs,
    /// Print one screen of what the recording holds now, without a terminal
    #[arg(long, requires = "recording")]
    once: bool,
    /// Serve the view to Foxglove at this port of 127.0.0.1 [default: 8765]
    #[arg(
        long,
        value_name = "PORT",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "8765",
        conflicts_with = "once"
    )]
    foxglove: Option<u16>,
}

/// Runs `twum live`.
pub fn run(args: Args) -> Result<ExitCode> {
    if let Some(recording) = args.recording.as_ref().filter(|_| args.connect.is_explicit()) {
        bail!("{} or --port: a recording is followed, a port is watched; not both", recording.display());
    }
    match &args.recording {
        Some(recording) if args.once => print_once(recording, args.record.json),
        _ if !std::io::stdout().is_terminal() && args.foxglove.is_none() => {
            bail!("this view needs a terminal; `--once` prints one screen of a recording, `--foxglove` serves it")
        }
        Some(recording) => follow(recording, Screen::new(args.foxglove)?),
        None => watch(&args.connect, &args.record, Screen::new(args.foxglove)?),
    }
}

fn print_once(recording: &Path, json: bool) -> Result<ExitCode> {
    let mut decoder = Decoder::open(recording)?;
    let mut view = LiveView::new();
    take_all(&mut decoder, &mut view)?;
    if json {
        let notes: Vec<&str> = view.notes_after(0).0.collect();
        let latest = view.history().last();
        println!("{}", serde_json::json!({ "latest": latest, "link": decoder.statistics(), "notes": notes }));
        return Ok(ExitCode::SUCCESS);
    }
    let mut terminal = Terminal::new(TestBackend::new(120, 40))?;
    terminal.draw(|frame| draw(&view, frame, &recording.display().to_string(), decoder.statistics()))?;
    for row in terminal.backend().buffer().content.chunks(120) {
        let line: String = row.iter().map(|cell| cell.symbol()).collect();
        println!("{}", line.trim_end());
    }
    Ok(ExitCode::SUCCESS)
}

fn take_all(decoder: &mut Decoder, view: &mut LiveView) -> Result<()> {
    while let Some(item) = decoder.next_item()? {
        if let Item::Device { header, message, .. } = item {
            view.observe(header.time_us, &message);
        }
    }
    Ok(())
}

/// Where the view is shown: on the terminal if there is one, and to Foxglove if asked for.
struct Screen {
    terminal: Option<DefaultTerminal>,
    /// A key was pressed that ends it.
    quit: Arc<AtomicBool>,
    server: Option<LiveServer>,
}

impl Screen {
    fn new(port: Option<u16>) -> Result<Self> {
        let server = port.map(LiveServer::start).transpose()?;
        if let Some(server) = &server {
            eprintln!("serving {}", server.address());
        }
        let terminal = match std::io::stdout().is_terminal() {
            true => Some(ratatui::try_init().context("cannot take over the terminal")?),
            false => None,
        };
        let quit = Arc::<AtomicBool>::default();
        if terminal.is_some() {
            watch_keys(quit.clone());
        }
        Ok(Self { terminal, quit, server })
    }

    /// Shows the view, then waits for the next time; whether to end.
    fn show(&mut self, view: &LiveView, heading: &str, link: LinkStatistics) -> Result<bool> {
        if let Some(server) = &mut self.server {
            server.send(view);
        }
        if INTERRUPTED.load(Ordering::Relaxed) || (self.terminal.is_some() && !std::io::stdout().is_terminal()) {
            // A terminal whose window was closed is none any more.
            return Ok(true);
        }
        let Some(terminal) = &mut self.terminal else {
            thread::sleep(DRAW_EVERY);
            return Ok(INTERRUPTED.load(Ordering::Relaxed));
        };
        let heading = match &self.server {
            Some(server) => format!("{heading}   {}", server.address()),
            None => heading.to_owned(),
        };
        terminal.draw(|frame| draw(view, frame, &heading, link))?;
        thread::sleep(DRAW_EVERY);
        Ok(self.quit.load(Ordering::Relaxed))
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        if self.terminal.is_some() {
            ratatui::restore();
        }
    }
}

fn follow(recording: &Path, mut screen: Screen) -> Result<ExitCode> {
    catch_interrupts()?;
    let mut decoder = Decoder::open(recording)?;
    decoder.follow();
    let mut view = LiveView::new();
    loop {
        take_all(&mut decoder, &mut view)?;
        let ended = if decoder.integrity().ending == Ending::Finished { " (finished)" } else { "" };
        if screen.show(&view, &format!("{}{ended}", recording.display()), decoder.statistics())? {
            return Ok(ExitCode::SUCCESS);
        }
    }
}

/// Shows what the board says to the program that holds its port, until that ends.
fn watch_through(mut board: Watching, mut screen: Screen) -> Result<ExitCode> {
    catch_interrupts()?;
    let mut view = LiveView::new();
    loop {
        for _ in 0..PIECES {
            let Some(received) = board.next(Duration::from_millis(1)) else { return Ok(ExitCode::SUCCESS) };
            if received.is_empty() {
                break;
            }
            received.iter().for_each(|received| view.observe(received.header.time_us, &received.message));
        }
        if screen.show(&view, "board, through the program that holds its port", LinkStatistics::default())? {
            return Ok(ExitCode::SUCCESS);
        }
    }
}

/// Records on this thread, as every other command does, and draws on another.
fn watch(connect: &ConnectArgs, record: &RecordArgs, screen: Screen) -> Result<ExitCode> {
    let port = connect.port()?;
    if let Ok(board) = relay::watch_through(&port) {
        return match &record.out {
            None => watch_through(board, screen),
            Some(_) => bail!("another program holds {port} and records, if anybody does: leave --out away"),
        };
    }
    let experiment = Experiment {
        configuration: None,
        capture: ALL_STREAMS,
        action: Action::Watch(Duration::from_secs(24 * 3600)),
        recording: record.out.clone(),
        motor: String::new(),
    };
    let (sender, receiver) = sync_channel::<Received>(WAITING);
    let drawing = thread::spawn(move || {
        let shown = show_received(&receiver, screen);
        // Without a screen nobody would end it.
        INTERRUPTED.store(true, Ordering::Relaxed);
        shown
    });
    let outcome = connect.perform(experiment, |received| {
        let _ = sender.try_send(received.clone());
    });
    drop(sender);
    let drawn = drawing.join().unwrap_or(Ok(()));
    // Being told to end is how a view ends.
    let outcome = Outcome { interrupted: false, ..outcome? };
    drawn?;
    record.conclude(&outcome, None, None)
}

fn show_received(receiver: &Receiver<Received>, mut screen: Screen) -> Result<()> {
    let mut view = LiveView::new();
    loop {
        loop {
            match receiver.try_recv() {
                Ok(received) => view.observe(received.header.time_us, &received.message),
                Err(TryRecvError::Empty) => break,
                Err(TryRecvError::Disconnected) => return Ok(()),
            }
        }
        if screen.show(&view, "board", LinkStatistics::default())? {
            return Ok(());
        }
    }
}

/// Sets the flag when `q` or Ctrl-C is pressed, or no key can be any more. On a thread of its own: on a terminal that is gone,
/// reading keys comes to no end (crossterm 0.29 reads its end of file again and again), and must not keep the view from ending.
fn watch_keys(quit: Arc<AtomicBool>) {
    thread::spawn(move || {
        let asks = |event: Event| match event {
            Event::Key(key) => {
                let interrupts = key.code == KeyCode::Char('c') && key.modifiers.contains(event::KeyModifiers::CONTROL);
                interrupts || matches!(key.code, KeyCode::Char('q') | KeyCode::Esc)
            }
            _ => false,
        };
        while event::read().is_ok_and(|event| !asks(event)) {}
        quit.store(true, Ordering::Relaxed);
    });
}
