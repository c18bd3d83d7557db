//! The firmware's own library on the simulated chip: its wires, its tasks, its interrupts.

use super::clock;
use super::flash::Flash;
use super::silicon::Silicon;
use super::wire::{Uart, Wire};
use embassy_futures::block_on;
use embassy_futures::join::join5;
use embedded_hal::digital::{ErrorType as PinErrorType, InputPin};
use embedded_io_async::{ErrorType, Read, Write};
use std::cell::Cell;
use std::convert::Infallible;
use std::future::Future;
use std::pin::Pin;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Wake, Waker};
use twum_firmware::Shared;
use twum_firmware::control::Control;
use twum_firmware::driver::{DriverPort, serve};
use twum_firmware::encoder::EncoderInterrupt;
use twum_firmware::link::{About, receive, transmit};
use twum_firmware::output::{Latch, Output};
use twum_firmware::queues::Queues;
use twum_firmware::stage::{self, Flags, Stage};
use twum_firmware::store::{self, Store};
use twum_firmware::watchdog::{Watchdog, supervise};
use twum_shared::message::ResetCause;

/// Tasks ask to be polled through this.
#[derive(Debug, Default)]
pub struct Flag(AtomicBool);

impl Wake for Flag {
    fn wake(self: Arc<Self>) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// The driver board's wires, as the firmware sees them.
struct DriverUart {
    uart: Uart,
    silicon: Silicon,
    flags: &'static Flags,
}

impl ErrorType for DriverUart {
    type Error = Infallible;
}

impl Read for DriverUart {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        self.uart.read(buffer).await
    }
}

impl Write for DriverUart {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        self.uart.write(bytes).await
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

impl DriverPort for DriverUart {
    fn to_text(&mut self) {
        stage::to_text(&self.silicon, self.flags);
        self.uart.rx.clear();
    }

    fn to_hardware(&mut self) {
        stage::to_hardware(&self.silicon, self.flags);
    }
}

struct EncoderPin(Rc<Cell<bool>>);

impl PinErrorType for EncoderPin {
    type Error = Infallible;
}

impl InputPin for EncoderPin {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(self.0.get())
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(!self.0.get())
    }
}

struct Feeder(Rc<Cell<u64>>);

impl Watchdog for Feeder {
    fn feed(&mut self) {
        self.0.set(clock::now_us());
    }
}

/// As much of a text as the field holds.
fn shortened<const N: usize>(text: &str) -> heapless::String<N> {
    let mut out = heapless::String::new();
    // What no longer fits is left out.
    let _ = text.chars().try_for_each(|c| out.push(c));
    out
}

type Tasks = Pin<Box<dyn Future<Output = ()>>>;

/// The firmware's part of a board, from one boot to the next.
pub struct Firmware {
    pub shared: &'static Shared,
    pub flags: &'static Flags,
    pub latch: &'static Latch,
    pub control: Control<'static, Stage<Silicon>>,
    pub interrupt: EncoderInterrupt<'static>,
    pub tasks: Tasks,
    pub woken: Arc<Flag>,
    pub waker: Waker,
    pub next_tick_us: u64,
}

impl Firmware {
    fn boot(
        silicon: &Silicon,
        uart: Uart,
        driver: Uart,
        pin: EncoderPin,
        fed: Rc<Cell<u64>>,
        flash: Flash,
        about: About,
    ) -> Self {
        // A chip keeps these in static memory; a simulated boot leaks them (30 KB), which keeps every lifetime the chip's.
        let flags: &'static Flags = Box::leak(Box::new(Flags::new()));
        let latch: &'static Latch = Box::leak(Box::new(Latch::new()));
        let output = Output::boot(Stage::new(silicon.clone(), flags), latch);
        let driver = DriverUart { uart: driver, silicon: silicon.clone(), flags };
        let shared: &'static Shared = Box::leak(Box::new(Shared::new()));
        let queues: &'static mut Queues = Box::leak(Box::new(Queues::new()));
        let (control_ends, edges, transmit_ends) = queues.split();
        let mut control = Control::new(shared, control_ends, output, about.reset);
        let mut store = Store::new(flash, Flash::RANGE).expect("the range is whole pages");
        if let Some(configuration) = block_on(store.load()) {
            // As on a chip: one that no longer validates leaves the board unconfigured.
            let _ = control.restore(configuration);
        }
        let receiver = uart.clone();
        let tasks: Tasks = Box::pin(async move {
            join5(
                receive(shared, receiver),
                transmit(shared, transmit_ends, about, uart),
                serve(shared, driver, pin),
                supervise(shared, Feeder(fed)),
                store::keep(shared, store),
            )
            .await;
        });
        let woken = Arc::new(Flag(AtomicBool::new(true)));
        Self {
            shared,
            flags,
            latch,
            control,
            interrupt: EncoderInterrupt::new(shared, edges),
            tasks,
            waker: Waker::from(woken.clone()),
            woken,
            next_tick_us: clock::now_us(),
        }
    }

    /// Lets the tasks run until none is ready.
    pub fn poll(&mut self) {
        let mut context = Context::from_waker(&self.waker);
        while self.woken.0.swap(false, Ordering::Relaxed) {
            // The tasks never end.
            let _ = self.tasks.as_mut().poll(&mut context);
        }
    }
}

/// Starts the firmware on the wires that a chip has: to and from the host, from and to the driver board.
pub fn boot(
    silicon: &Silicon,
    level: &Rc<Cell<bool>>,
    fed_us: &Rc<Cell<u64>>,
    flash: &Flash,
    [to_board, from_board, driver_rx, driver_tx]: &[Wire; 4],
    simulates: &str,
    reset: ResetCause,
) -> Firmware {
    let uart = Uart { rx: to_board.clone(), tx: from_board.clone() };
    let driver_uart = Uart { rx: driver_rx.clone(), tx: driver_tx.clone() };
    let pin = EncoderPin(level.clone());
    let about = About {
        firmware: heapless::String::try_from(env!("CARGO_PKG_VERSION")).unwrap_or_default(),
        chip: shortened(simulates),
        reset,
    };
    Firmware::boot(silicon, uart, driver_uart, pin, fed_us.clone(), flash.clone(), about)
}
