//! Boots a chip: output off, clocks, pins, interrupts, tasks. What differs between chips is in `board`, one file a kind.

#[cfg_attr(target_arch = "xtensa", path = "esp32.rs")]
#[cfg_attr(target_arch = "riscv32", path = "riscv.rs")]
mod board;
mod flash;
mod interrupts;
mod panic;
mod port;
mod pwm;
mod stage;

use core::convert::Infallible;
use embassy_executor::Spawner;
use embedded_hal::digital::{ErrorType, InputPin};
use esp_backtrace as _;
use esp_hal::Async;
use esp_hal::rtc_cntl::{Rtc, Rwdt, RwdtStage};
use esp_hal::timer::timg::TimerGroup;
use esp_hal::uart::{self, RxErrorKind, Uart, UartRx, UartTx};
use flash::Flash;
use heapless::String;
use interrupts::ControlLoop;
use port::Port;
use stage::Stage;
use static_cell::{ConstStaticCell, StaticCell};
use twum_firmware::control::Control;
use twum_firmware::encoder::EncoderInterrupt;
use twum_firmware::link::{self, About};
use twum_firmware::output::Output;
use twum_firmware::queues::{Queues, TransmitEnds};
use twum_firmware::store::{self, Store};
use twum_firmware::watchdog::{self, Watchdog};
use twum_firmware::{Shared, driver};

esp_bootloader_esp_idf::esp_app_desc!();

/// The link to the host.
const LINK_BAUD: u32 = 921_600;
/// Bytes in the receive FIFO (of 128) at which it is emptied: 64 more, 0.7 ms, may come before one is lost.
const LINK_RX_THRESHOLD: u16 = 64;
/// The driver board's text mode.
const DRIVER_BAUD: u32 = 19_200;
/// Longer than erasing a flash page (0.4 s), which the watchdog's own tasks wait for.
const WATCHDOG_MS: u64 = 1_000;

static SHARED: Shared = Shared::new();
static QUEUES: ConstStaticCell<Queues> = ConstStaticCell::new(Queues::new());
static CONTROL: StaticCell<Control<'static, Stage>> = StaticCell::new();

#[esp_rtos::main]
async fn main(spawner: Spawner) {
    // Before anything that can fail: these write the PWM pin's registers, and nothing comes before them.
    let output = Output::boot(Stage::new(stage::Chip, &stage::FLAGS), &panic::LATCH);
    board::watch_supply();

    let reset = panic::take_mark().unwrap_or_else(board::reset_cause);
    let parts = board::parts(esp_hal::init(esp_hal::Config::default().with_cpu_clock(esp_hal::clock::CpuClock::max())));
    let mut dog = Rtc::new(parts.rtc_timer).rwdt;
    dog.set_timeout(RwdtStage::Stage0, esp_hal::time::Duration::from_millis(WATCHDOG_MS));
    dog.enable();
    esp_rtos::start(TimerGroup::new(parts.timg0).timer0, parts.from_cpu_intr0);

    pwm::start(parts.ledc);

    let (control_ends, edges, transmit_ends) = QUEUES.take().split();
    let control = CONTROL.init(Control::new(&SHARED, control_ends, output, reset));
    let mut store = flash::open(parts.flash).and_then(|(flash, range)| Store::new(flash, range));
    if let Some(store) = &mut store
        && let Some(configuration) = store.load().await
    {
        // One that no longer validates leaves the board unconfigured, and so not armable.
        let _ = control.restore(configuration);
    }
    board::start_control(
        parts.control,
        parts.encoder,
        ControlLoop::new(control, EncoderInterrupt::new(&SHARED, edges)),
    );

    let rx = uart::RxConfig::default()
        .with_fifo_full_threshold(LINK_RX_THRESHOLD)
        .with_reported_errors(RxErrorKind::FifoOverflowed);
    let config = uart::Config::default().with_baudrate(LINK_BAUD).with_rx(rx);
    let link = Uart::new(parts.link, config).expect("921600 baud is within every chip's range");
    let (rx, tx) = link.with_rx(parts.link_rx).with_tx(parts.link_tx).into_async().split();
    let config = uart::Config::default()
        .with_baudrate(DRIVER_BAUD)
        .with_rx(uart::RxConfig::default().with_fifo_full_threshold(1));
    let driver = Uart::new(parts.driver, config).expect("19200 baud is within every chip's range").into_async();

    let firmware = String::try_from(env!("CARGO_PKG_VERSION")).unwrap_or_default();
    let about = About { firmware, chip: String::try_from(board::CHIP).unwrap_or_default(), reset };
    let once = "each task is spawned once";
    spawner.spawn(receive(rx).expect(once));
    spawner.spawn(transmit(transmit_ends, about, tx).expect(once));
    spawner.spawn(serve_driver(Port::new(driver)).expect(once));
    spawner.spawn(reboot().expect(once));
    spawner.spawn(supervise(Dog(dog)).expect(once));
    if let Some(store) = store {
        spawner.spawn(keep(store).expect(once));
    }
}

#[embassy_executor::task]
async fn receive(port: UartRx<'static, Async>) {
    link::receive(&SHARED, port).await;
}

#[embassy_executor::task]
async fn transmit(queues: TransmitEnds<'static>, about: About, port: UartTx<'static, Async>) {
    link::transmit(&SHARED, queues, about, port).await;
}

#[embassy_executor::task]
async fn serve_driver(port: Port) {
    driver::serve(&SHARED, port, EncoderLevel).await;
}

#[embassy_executor::task]
async fn keep(store: Store<Flash>) {
    store::keep(&SHARED, store).await;
}

#[embassy_executor::task]
async fn supervise(dog: Dog) {
    watchdog::supervise(&SHARED, dog).await;
}

#[embassy_executor::task]
async fn reboot() {
    SHARED.reboot.wait().await;
    panic::reboot();
}

/// The RTC's watchdog: it resets the whole chip, whatever its cores do.
struct Dog(Rwdt);

impl Watchdog for Dog {
    fn feed(&mut self) {
        self.0.feed();
    }
}

/// The encoder pin for the alignment routine. The interrupt owns the pin; this only reads it.
struct EncoderLevel;

impl ErrorType for EncoderLevel {
    type Error = Infallible;
}

impl InputPin for EncoderLevel {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(stage::level(board::ENCODER_PIN))
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        Ok(!stage::level(board::ENCODER_PIN))
    }
}
