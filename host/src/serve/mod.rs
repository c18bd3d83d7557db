//! The bench in a browser: one program owns the board's port, records every run as the command line does, and serves a page.
//!
//! [`owner`] is the thread that owns the port. [`tap`] shows [`board`] what comes over it. [`stream`] brings that to every page
//! at the page's own pace, and [`holder`] knows which of them may move the motor, and stops it when that page falls silent.
//! [`door`] says who comes in, [`routes`] what can be asked. Computing that takes long is done by the command line itself, in
//! a program of its own (`studies`), as are sweeps of a stator ([`sweeping`]): they can neither hold up the port nor bring the
//! server down.

pub mod answer;
pub mod assets;
pub mod board;
pub mod door;
pub mod folder;
pub mod holder;
mod model;
pub mod owner;
pub mod request;
pub mod routes;
mod runs;
pub mod series;
pub mod settings;
pub mod stream;
mod studies;
mod sweep;
pub mod sweeping;
pub mod tap;

use crate::model::motor::Motor;
use crate::model::parameters::Flavour;
use board::Board;
use door::Door;
use folder::Folder;
use holder::Holder;
use owner::{Bench, Owner};
use std::collections::HashSet;
use std::io;
use std::net::{SocketAddr, TcpListener, ToSocketAddrs};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::JoinHandle;
use std::time::Duration;
use studies::Studies;
use sweep::Sweeps;
use sweeping::{Instruments, Sweeping};
use thiserror::Error;

/// A lease that has run out is seen within this time.
const LEASE_LOOKED_AT: Duration = Duration::from_millis(20);
/// A page that falls behind while nothing is going on, as while it draws a long recording, keeps the motor for so long more.
const AT_REST: Duration = Duration::from_secs(10);
/// The same while a stator is swept: the page draws thousands of points meanwhile, and a generator's few volts turn no motor.
const AT_A_SWEEP: Duration = Duration::from_secs(5);
/// Threads that answer pages.
const THREADS: usize = 2;

/// What the routes know.
pub struct App {
    board: Arc<Board>,
    owner: Arc<Owner>,
    holder: Arc<Holder>,
    /// Of the motor, to hold controllers against.
    readings: Arc<[(Motor, Flavour)]>,
    door: Door,
    folder: Folder,
    studies: Studies,
    sweeps: Sweeps,
    sweeping: Sweeping,
    /// Streams that are open.
    pages: AtomicUsize,
    /// Their names.
    names: Mutex<HashSet<String>>,
}

impl App {
    fn names(&self) -> MutexGuard<'_, HashSet<String>> {
        self.names.lock().expect("nothing panics while it holds the names")
    }

    fn enter(&self, page: &str) {
        self.names().insert(page.to_owned());
    }

    fn leave(&self, page: &str) {
        self.names().remove(page);
    }

    fn has_page(&self, page: &str) -> bool {
        self.names().contains(page)
    }
}

/// Why nothing is served.
#[derive(Debug, Error)]
pub enum ServeError {
    /// The address cannot be had.
    #[error("cannot listen at {asked}: {reason}; name another with --listen")]
    Listen {
        /// What was asked for.
        asked: String,
        /// The system's reason.
        reason: io::Error,
    },
    /// The folder cannot be had.
    #[error("{folder}: {reason}")]
    Folder {
        /// The folder.
        folder: String,
        /// The system's reason.
        reason: io::Error,
    },
    /// The system gives no threads.
    #[error("cannot serve: {0}")]
    System(io::Error),
}

/// A server that listens, and does not serve yet.
pub struct Server {
    app: Arc<App>,
    thread: JoinHandle<()>,
    listener: TcpListener,
    address: SocketAddr,
    is_over: Arc<AtomicBool>,
}

/// Ends a server from another thread.
#[derive(Clone)]
pub struct Ending {
    owner: Arc<Owner>,
    is_over: Arc<AtomicBool>,
}

impl Ending {
    /// Stops the motor and ends the server.
    pub fn end(&self) {
        self.owner.quit();
        self.is_over.store(true, Ordering::Relaxed);
    }
}

impl Server {
    /// Listens at `listen` (`ADDRESS:PORT`), opens `folder`, and begins to reach the board on `port` by `bench`;
    /// a stator is swept with `instruments`.
    ///
    /// # Errors
    /// When the address or the folder cannot be had. A board that cannot be reached is waited for.
    pub fn new(
        listen: &str,
        folder: &Path,
        port: &str,
        bench: Box<dyn Bench>,
        instruments: Instruments,
    ) -> Result<Self, ServeError> {
        let failed = |reason| ServeError::Listen { asked: listen.to_owned(), reason };
        let addresses: Vec<SocketAddr> = listen.to_socket_addrs().map_err(failed)?.collect();
        let listener = TcpListener::bind(&*addresses).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        let folder = Folder::open(folder)
            .map_err(|reason| ServeError::Folder { folder: folder.display().to_string(), reason })?;
        let asked = listen.rsplit_once(':').map_or(listen, |(host, _)| host).trim_matches(['[', ']']);
        let door = Door::new(asked, address.ip().is_loopback());
        let board = Arc::new(Board::new(port));
        let holder = Arc::<Holder>::default();
        let readings = bench.readings().into();
        let (owner, thread) = Owner::start(bench, Arc::clone(&board), Arc::clone(&holder));
        let app = Arc::new(App {
            board,
            owner,
            holder,
            readings,
            door,
            folder,
            studies: Studies::default(),
            sweeps: Sweeps::default(),
            sweeping: Sweeping::new(instruments),
            pages: AtomicUsize::new(0),
            names: Mutex::default(),
        });
        Ok(Self { app, thread, listener, address, is_over: Arc::default() })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What to open in a browser. The token, where there is one, stands in the fragment, which no browser sends.
    pub fn url(&self) -> String {
        let fragment = self.app.door.token().map_or_else(String::new, |token| format!("#token={token}"));
        format!("http://{}/{fragment}", self.address)
    }

    /// Ends it from elsewhere.
    pub fn ending(&self) -> Ending {
        Ending { owner: Arc::clone(&self.app.owner), is_over: Arc::clone(&self.is_over) }
    }

    /// Serves until it is ended; motor and generator are off then, or could not be told.
    ///
    /// # Errors
    /// When the system gives no threads or sockets.
    pub fn serve(self) -> Result<(), ServeError> {
        let Self { app, thread, listener, is_over, .. } = self;
        let watched = (Arc::clone(&app), Arc::clone(&is_over));
        let lease = std::thread::spawn(move || watch_lease(&watched.0, &watched.1));
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(THREADS)
            .enable_all()
            .build()
            .map_err(ServeError::System)?;
        let served = runtime.block_on(async {
            let listener = tokio::net::TcpListener::from_std(listener).map_err(ServeError::System)?;
            let router = routes::router(Arc::clone(&app));
            tokio::select! {
                served = std::future::IntoFuture::into_future(axum::serve(listener, router)) => served.map_err(ServeError::System),
                () = over(&is_over) => Ok(()),
            }
        });
        app.owner.quit();
        is_over.store(true, Ordering::Relaxed);
        app.studies.end();
        sweeping::wait(&app);
        // Threads that fail have said so.
        let _ = thread.join();
        let _ = lease.join();
        runtime.shutdown_background();
        served
    }
}

async fn over(is_over: &AtomicBool) {
    while !is_over.load(Ordering::Relaxed) {
        tokio::time::sleep(LEASE_LOOKED_AT).await;
    }
}

/// Stops what a page set in motion that is gone.
fn watch_lease(app: &App, is_over: &AtomicBool) {
    while !is_over.load(Ordering::Relaxed) {
        let is_at_work = app.board.is_at_work();
        let patience = match is_at_work {
            true if app.owner.has_aside() => AT_A_SWEEP,
            true => Duration::ZERO,
            false => AT_REST,
        };
        if app.holder.expire(patience) {
            if is_at_work {
                // Nobody waits for the answer; the state says how it went.
                drop(app.owner.stop());
                app.board.say("the page that held the motor is gone or does not keep up: the motor is stopped");
            } else {
                app.board.say("the page that held the motor is gone");
            }
        }
        std::thread::sleep(LEASE_LOOKED_AT);
    }
}
