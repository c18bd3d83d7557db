//! Data sets of the generators on which the diagnosis once fell short.

use twum_host::diagnose::answer::{Diagnosis, Verdict, text};
use twum_tests::suite::Case;
use twum_tests::truth::Kind;

/// The answer of the command on one of the generators' data sets.
fn of_a_case(generator: &str, kind: Kind, seed: u64) -> Diagnosis {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let at = folder.path().join("data");
    let case = Case { generator: generator.to_owned(), kind, seed };
    case.make().expect("it can be made").write(&at).expect("the folder can be written");
    super::answer(&at)
}

/// A clock of three thousandths in runs of 3.35 s: half a PWM period of drift. Fails if it is looked for from no error alone.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_clock_is_found_that_drifts_by_half_a_period_beside_a_strong_settling() {
    let d = of_a_case("d", Kind::Pair, 12_008);
    assert!(["clock-error", "frequency-settling"].iter().all(|n| d.suspected().contains(n)), "{:?}", d.suspected());
    let clock = &d.effects.iter().find(|e| e.name == "clock-error").expect("it is suspected").parameters;
    assert!((clock["relative_clock_error"].value - 0.003).abs() < 1e-4, "{clock:?}");
}

/// The listed controller with three tenths of its derivative gain, which moves the signal by a hundredth of a step. Fails if the two signals are
/// held to be the same while they differ by more than they were printed to.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_controller_that_differs_by_a_hundredth_of_a_step_is_named() {
    assert_eq!(of_a_case("e", Kind::Closed, 572).named(), ["controller-mismatch"]);
}

/// Nothing is hidden in a loop whose short pulses fit a contact that is soft over six tenths of the speed. Fails if that is judged where
/// only pulses of a loop show it.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_loop_has_no_soft_contact() {
    assert_eq!(of_a_case("e", Kind::Closed, 581).verdict, Verdict::None);
}

/// Nothing is hidden, and nothing is said.
fn nothing_is_said(generator: &str, seed: u64) {
    let d = of_a_case(generator, Kind::Null, seed);
    assert_eq!(d.verdict, Verdict::None, "{seed}: {:?}", d.suspected());
}

/// Both of a pair are suspected, and nothing else is named.
fn both_are_found(generator: &str, seed: u64, hidden: [&str; 2]) {
    let d = of_a_case(generator, Kind::Pair, seed);
    assert!(hidden.iter().all(|n| d.suspected().contains(n)), "{seed}: {:?}", d.suspected());
    assert!(d.named().iter().all(|n| hidden.contains(n)), "{seed}: {:?}", d.named());
}

/// A delay and a settling, of which a sag does more than either alone, and whose motors alone leave nothing for the other. Fails if pairs are not
/// looked for from the motor of either.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_pair_is_found_of_which_a_third_effect_does_more_than_each_alone() {
    both_are_found("d", 12_084, ["start-delay", "frequency-settling"]);
}

/// Fails if a better baseline forgets what was found beside the old one, or if 6 % of what a clock makes count as an error of its form beside a
/// set that leaves 1 %.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_pair_is_found_beside_a_clock_that_makes_nearly_all_of_the_error() {
    both_are_found("d", 12_067, ["clock-error", "preload-runout"]);
}

/// An asymmetry of which an oracle removes half of the error, which on runs held out gained 3 %: what all runs would change of the model was taken
/// for what was fitted without them.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_what_is_named_helps_where_it_was_not_fitted() {
    let d = of_a_case("e", Kind::Single, 321);
    let effect = d.effects.iter().find(|e| e.name == "direction-asymmetry").expect("it is named");
    assert!(effect.status == "named" && effect.gain_heldout > 0.4, "{} {}", effect.status, effect.gain_heldout);
}

/// Six runs, of which the longest makes 0.595 of a turn. Fails if what goes with the angle is looked for from 0.6 of a turn on.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_an_eccentric_wheel_shows_in_less_than_a_turn() {
    both_are_found("e", 277, ["clock-error", "encoder-eccentricity"]);
}

/// A friction that falls by a third in the first ten of 60 runs. Fails if no form of wear is one of the friction that comes to an end, or if what
/// the other runs do not have may be a runout: that was NAMED.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_friction_that_runs_in_is_wear_and_no_runout() {
    let d = of_a_case("e", Kind::Single, 375);
    assert_eq!(d.named(), ["run-in-wear"]);
    let wear = d.effects.iter().find(|e| e.name == "run-in-wear").expect("it is named");
    let friction = &wear.parameters["friction_change_once_run_in"];
    assert!((-0.5..-0.2).contains(&friction.value), "{friction:?}");
}

/// A word lost in each of two slow runs of 19, one of them as the drive ends. Fails if a gap with an odd number of edges in it is none, if an edge
/// where the record was joined is compared, or if a clock is preferred because another error is larger than what the gaps take.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_lost_words_of_a_slow_rotor_are_found_beside_a_delay() {
    both_are_found("e", 284, ["dropped-samples", "start-delay"]);
}

/// A duty in uneven steps, 5 nats ahead where 8.8 are asked, and for certain a quarter of the error on runs held out. Fails if only the evidence is
/// asked: then it is none.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_what_is_likely_and_helps_for_certain_is_said_and_not_named() {
    let d = of_a_case("d", Kind::Single, 20_044);
    assert_eq!(d.suspected(), ["duty-quantisation"]);
    assert!(d.named().is_empty(), "{:?}", d.named());
}

/// A saturation of a motor that is driven beside its resonance. Fails if every motor is driven at it: then a sag, of the fourth power of the duty, is
/// as likely.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_saturation_is_no_sag_of_a_wave_at_its_resonance() {
    let d = of_a_case("d", Kind::Single, 20_026);
    let likely = |name: &str| d.effects.iter().find(|e| e.name == name).and_then(|e| e.probability).unwrap_or(0.0);
    assert!(d.suspected().contains(&"high-duty-saturation"), "{:?}", d.suspected());
    assert!(
        2.0 * likely("supply-sag") < likely("high-duty-saturation"),
        "{} {}",
        likely("supply-sag"),
        likely("high-duty-saturation")
    );
}

/// Nothing is hidden; a rotor that springs back at rest is for certain nearer to one that sticks, by 0.109 of the error on runs held out (0.035 to
/// 0.166). Fails if a name need not for certain remove a tenth of it: it was NAMED; or if the page says that what is alone possible is the cause.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_what_may_remove_less_than_a_tenth_of_the_error_is_no_name() {
    let d = of_a_case("e", Kind::Null, 560);
    assert!(d.named().is_empty(), "{:?}", d.named());
    let page = text(&d);
    assert!(page.starts_with("AMBIGUOUS: perhaps stribeck-friction\n"), "{page}");
}

/// Unequal slots beside a weak wear. Fails if what a wear without an end leaves over the order silences the slots.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_unequal_slots_are_named_beside_a_weak_wear() {
    let d = of_a_case("d", Kind::Pair, 20_025);
    assert_eq!((d.verdict, d.named()), (Verdict::Named, vec!["unequal-edges"]));
}

/// Nothing is hidden; what lies over the phase of the PWM brings half a per cent on runs held out. Fails if that is enough for `unknown`.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_what_brings_next_to_nothing_is_not_unknown() {
    nothing_is_said("e", 337);
}

/// Nothing is hidden; a settling or a sag takes 4 % of the error on runs held out, by an interval without none. Fails if that is enough to be possible.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_what_brings_less_than_a_twentieth_is_not_possible() {
    nothing_is_said("e", 640);
}

/// A contact that gives way over two fifths of the wave's speed. Fails if so soft a one may be another motor's own: the refitted motor had it, and the
/// answer was none.
#[test]
fn a_softer_contact_than_any_motors_own_is_named() {
    assert_eq!(of_a_case("d", Kind::Single, 20_018).named(), ["contact-stiffening"]);
}

/// A clock that drifts. Fails if the drift is looked for from a clock that is right alone: it was none.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_clock_that_drifts_is_found_to_drift() {
    let d = of_a_case("e", Kind::Pair, 473);
    assert_eq!(d.named(), ["clock-error"]);
    let drift = &d.effects[0].parameters["clock_drift_per_s"];
    assert!(drift.ci95[0] * drift.ci95[1] > 0.0, "{drift:?}");
}

/// A delay that grows with the rest, beside a clock that makes nearly all of the error. Fails if a share of what a clock makes counts as error of the
/// forms: then it was none, as was a rounding beside another clock.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_what_stands_beside_a_clock_is_found() {
    let delayed = of_a_case("c", Kind::Pair, 20_050);
    assert_eq!(delayed.named(), ["clock-error"]);
    assert!(delayed.suspected().contains(&"start-delay"), "{:?}", delayed.suspected());
    assert_eq!(of_a_case("e", Kind::Pair, 552).named(), ["clock-error", "duty-quantisation"]);
}

/// Half of the friction is gone in a warm motor. Fails if warmth changes the speed alone: the friction that is left over the order of the runs was
/// named a wear.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_friction_that_warms_away_is_a_heating() {
    assert_eq!(of_a_case("e", Kind::Single, 464).named(), ["resonance-heating"]);
}

/// Nothing is hidden; the comparator behind the wheel hangs back by a third of a pitch where the rotor turns counter-clockwise. Fails if a rotor is
/// believed to turn a pitch at most before its first edge: then a delay of the start or a frequency that settles is named.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_comparator_that_hangs_back_has_no_cause() {
    for seed in [310, 436, 474, 571] {
        nothing_is_said("e", seed);
    }
}

/// Nothing is hidden; contacts that spring back move the pulses by a tenth of a millisecond, which edges timed to microseconds show. Fails if the
/// rotor's equation is believed to the last microsecond: then a delay of the start is named.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_pulses_a_tenth_of_a_millisecond_off_have_no_cause() {
    nothing_is_said("e", 278);
}

/// An eccentric wheel of 0.2 rad beside an asymmetry, in runs of which its error looks like words lost in four. Fails if lost words are not
/// looked for again beside what was found behind them.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_wheel_is_not_taken_for_lost_words() {
    let d = of_a_case("e", Kind::Pair, 289);
    assert!(d.suspected().contains(&"encoder-eccentricity"), "{:?}", d.suspected());
    assert!(!d.suspected().contains(&"dropped-samples"), "{:?}", d.suspected());
}

/// A clock that drifts by 5 % beside an eccentric wheel, in runs of which what is left looks like words lost in four, 3 % of the error. Fails if what
/// brings so little beside what was found is lost words.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_what_brings_little_beside_what_was_found_is_no_lost_words() {
    let d = of_a_case("b", Kind::Pair, 20_043);
    assert!(!d.suspected().contains(&"dropped-samples"), "{:?}", d.suspected());
    assert!(d.suspected().contains(&"encoder-eccentricity"), "{:?}", d.suspected());
    assert!(d.named().contains(&"clock-error"), "{:?}", d.suspected());
}

/// A friction that falls with the speed beside an asymmetry of 1.35 %, of which the library's form leaves half a floor. Fails if runs held out are fitted
/// to what the form gets wrong within them: then they speak against the asymmetry, and nothing is named.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_what_a_form_gets_wrong_does_not_strike_a_small_asymmetry() {
    both_are_found("c", 20_044, ["direction-asymmetry", "stribeck-friction"]);
}

/// A preload that changes by 9 % round the rotor, and with it both frictions and the wave. Fails if no form of a runout acts on all three: an
/// eccentric wheel was NAMED.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_runout_of_all_that_the_preload_does_is_not_named_a_wheel() {
    let d = of_a_case("e", Kind::Single, 409);
    assert!(d.suspected().contains(&"preload-runout"), "{:?}", d.suspected());
    assert!(d.named().is_empty(), "{:?}", d.named());
}

/// A wheel 0.012 rad off, whose course within the runs a course over the time takes as well, and a little more. Fails if that one hides it.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_course_over_time_does_not_hide_a_wheel() {
    let d = of_a_case("e", Kind::Single, 277);
    assert!(d.suspected().contains(&"encoder-eccentricity"), "{:?} {:?}", d.verdict, d.unknown);
}

/// A saturation of nearly all there is, beside wear. Fails if the wear's own rest over the order withholds both.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_rest_over_the_order_does_not_withhold_a_saturation() {
    both_are_found("e", 279, ["high-duty-saturation", "run-in-wear"]);
}

/// The weather over the runs, of which a spread of 0.7 % is left. Fails if that is believed of a motor.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_wander_of_the_runs_that_no_motor_has_is_unknown_over_the_order() {
    is_unknown_over("e", 513, "order");
}

/// A runout of the friction that takes four fifths of the error. Fails if what it changes is held against periods that repeat each other, which differ by
/// more than a hundredth of it: it was `none`.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_runout_of_the_friction_is_found_beside_a_sag() {
    both_are_found("e", 518, ["preload-runout", "supply-sag"]);
}

/// Sixteen runs of eight to ten turns. Fails if a wheel's size is that beside the errors of forms: it was 13 % too small, in an
/// interval of 8 %.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_wheel_that_turned_often_has_its_size() {
    let d = of_a_case("e", Kind::Pair, 517);
    let wheel = d.effects.iter().find(|e| e.name == "encoder-eccentricity").expect("it is suspected");
    let size = &wheel.parameters["eccentricity_rad"];
    assert!((size.value / 0.01318 - 1.0).abs() < 0.02, "{size:?}");
}

fn is_unknown_over(generator: &str, seed: u64, place: &str) {
    let d = of_a_case(generator, Kind::Outside, seed);
    assert_eq!(d.verdict, Verdict::Unknown, "{:?}", d.suspected());
    assert!(d.unknown[0].lives_in.starts_with(place), "{:?}", d.unknown);
}

/// Three sessions, and a part that was changed for a quarter of the runs. Fails if what comes and goes with their order is taken for chance.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_what_comes_and_goes_with_the_order_is_unknown_over_the_order() {
    is_unknown_over("d", 12_003, "order");
    is_unknown_over("e", 309, "order");
}

/// Fails if nobody looks at more than eight times a turn.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_teeth_are_unknown_over_the_angle() {
    is_unknown_over("d", 12_001, "angle");
}

/// A bearing's cage, and a beat over the time. Fails if only whole numbers of a turn are looked at, or no rate of the time.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_what_comes_at_a_rate_of_its_own_is_unknown_over_it() {
    is_unknown_over("e", 307, "angle, no whole number of times a turn");
    is_unknown_over("c", 16_400, "time, so many cycles a second");
}

/// A friction that falls with the slip, beside which a warmth was struck. Fails if what is left is not compared with the friction alone as well fitted, but
/// as the search left it, in another valley: then the directions differ, by 1 % of the friction, where they do not.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_what_leads_after_a_strike_is_held_against_what_is_as_well_fitted() {
    assert_eq!(of_a_case("e", Kind::Single, 667).named(), ["stribeck-friction"]);
}

/// A supply that rings within each pulse, which leaves 2.5 rpm where 0.6 are left without. Fails if nobody looks at what a pulse does while it lasts: it was
/// `none`.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_supply_that_rings_is_unknown_within_the_pulse() {
    is_unknown_over("e", 644, "PWM phase, within the pulse");
}

/// Runs that are slower at first if the one before went the other way. Fails if nobody looks at the run before: it was `none`.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_what_a_run_remembers_of_the_one_before_is_unknown_over_the_direction() {
    is_unknown_over("b", 17_111, "direction of the run before");
}

/// A half more speed about one duty, which a sag, a saturation or wear would each explain in part. Fails if it is `none` because none of
/// them is certain.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_what_nothing_certain_explains_is_unknown() {
    is_unknown_over("b", 17_108, "duty");
}

/// One of seven runs, of a motor that coasts for seconds, is slow enough to show its friction. Fails when it is scored by what the
/// others say of it: that missed it by 66 rpm, of a motor that makes 47, and called this the noise floor.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_run_that_alone_shows_the_friction_is_fitted_and_not_scored() {
    let d = of_a_case("c", Kind::Single, 8003);
    let missed_rpm = d.baseline.scores.rmse_speed_rpm.expect("there are runs to score");
    assert!(missed_rpm < 3.0, "{missed_rpm}");
    let said = d.notes.iter().find(|note| note.contains("no other run shows")).expect("it is said");
    assert!(said.contains("01-cw"), "{said}");
}

/// A clock that is wrong, and lost words. Fails if samples are no longer looked for beside a clock that was found wrong.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_lost_words_are_found_beside_a_wrong_clock() {
    both_are_found("d", 12_065, ["clock-error", "dropped-samples"]);
}

/// Thirteen words beside a grid of duties. Fails if a clock that does nearly as well as they stands in their place though the best set has none.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_few_lost_words_are_found_beside_another_effect() {
    let d = of_a_case("d", Kind::Pair, 12_077);
    assert!(d.suspected().contains(&"dropped-samples"), "{:?}", d.suspected());
}

/// Slots of which one kind is 2.3 times as wide as the other. Fails if words are looked for beside edges where equal slots have them: then every
/// interval is as wild as a gap.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_lost_words_are_found_beside_unequal_slots() {
    both_are_found("c", 20_031, ["dropped-samples", "unequal-edges"]);
}

/// A runout and a heating, beside which the end of five drives of 34 looks like lost words. Fails if gaps where the drive ends count though several
/// runs have one.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_how_a_rotor_stops_is_not_taken_for_lost_words() {
    both_are_found("e", 345, ["preload-runout", "resonance-heating"]);
}

/// A delay beside a settling, which a dead zone fits as well and does not help on runs held out. Fails if the delay falls with it.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_one_of_two_that_helps_where_it_was_not_fitted_is_enough() {
    both_are_found("e", 348, ["start-delay", "frequency-settling"]);
}

/// A motor one and a half per cent faster in one direction, beside a wrong clock. Fails if runs of both directions may differ by that for no reason.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_small_asymmetry_is_found_beside_a_wrong_clock() {
    both_are_found("e", 337, ["direction-asymmetry", "clock-error"]);
}

/// Fails if a set is left in the pool as it was weighed where the model was not refitted to the end: a settling with a term over the slots then led by 11
/// nats that it has not.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_what_a_refit_does_not_keep_leads_nowhere() {
    both_are_found("e", 482, ["unequal-edges", "frequency-settling"]);
}

/// Fails if the motor is looked for anew only beside effects that halve the noise: the dead zone was then behind what lives after the switchings.
#[test]
#[ignore = "takes long: .ci/run thorough"]
fn thorough_a_dead_zone_is_found_beside_which_the_motor_is_another() {
    let d = of_a_case("e", Kind::Single, 484);
    assert!(d.suspected().contains(&"dead-zone"), "{:?}", d.suspected());
}
