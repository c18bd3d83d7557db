//! The configuration a board keeps: read back, kept over a restart, refused where it is wrong.

use crate::bench::{Bench, default_configuration};
use twum_host::configuration::{overlay, to_toml};
use twum_host::link::LinkError;
use twum_host::sim::{Disturbance, Setup};
use twum_shared::encoder::CountSign;
use twum_shared::message::{Configuration, Refusal, ResetCause};
use twum_shared::step::ConfigSpec;

fn of_a_bench() -> Configuration {
    let mut configuration = Configuration::with_control(ConfigSpec::THESIS);
    (configuration.count_sign, configuration.pwm_hz, configuration.edges_per_rev) = (CountSign::Reversed, 60, 500);
    configuration.limits.position_max = 400;
    configuration
}

#[test]
fn what_a_board_was_sent_is_read_back_and_outlives_a_restart() {
    let mut bench = Bench::new(Setup::default());
    assert_eq!(bench.session.configuration().unwrap(), None, "a new board has none");
    bench.session.configure(of_a_bench()).unwrap();
    assert_eq!(bench.session.configuration().unwrap(), Some(of_a_bench()));
    bench.wait(50);
    for cause in [ResetCause::PowerOn, ResetCause::Watchdog, ResetCause::Software] {
        bench.board().disturb(Disturbance::Reset(cause));
        bench.session.hello().unwrap();
        assert_eq!(bench.session.configuration().unwrap(), Some(of_a_bench()), "{cause:?}");
    }
    bench.session.stop().unwrap();
    bench.session.configure(default_configuration()).unwrap();
    assert_eq!(bench.session.configuration().unwrap(), Some(default_configuration()));
}

#[test]
fn dumping_and_loading_is_the_identity_on_the_board() {
    let mut bench = Bench::new(Setup::default());
    bench.session.configure(of_a_bench()).unwrap();
    let dumped = to_toml(&bench.session.configuration().unwrap().unwrap());
    let loaded = overlay(&default_configuration(), &dumped).unwrap();
    bench.session.configure(loaded).unwrap();
    assert_eq!(to_toml(&bench.session.configuration().unwrap().unwrap()), dumped);
}

#[test]
fn a_configuration_is_read_back_while_armed_and_not_changed() {
    let mut bench = Bench::armed(default_configuration());
    assert_eq!(bench.session.configuration().unwrap(), Some(default_configuration()));
    let refused = bench.session.configure(of_a_bench());
    assert!(matches!(refused, Err(LinkError::Refused { reason: Refusal::Mode(_), .. })), "{refused:?}");
    assert_eq!(bench.session.configuration().unwrap(), Some(default_configuration()));
}
