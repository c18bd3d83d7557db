//! What the driver board answers: the sensor level, its lines, and alignment driven by whatever comes.

use twum_shared::alignment::{Action, Alignment, Event, MAX_ATTEMPTS};
use twum_shared::driver::{self, MAX_LINE};

/// Each event is a byte that says which, and, for a reply, its length and bytes.
pub fn driver_replies(data: &[u8]) {
    level(data);
    if let Ok(text) = std::str::from_utf8(data) {
        line(text);
    }
    align(data);
}

fn level(reply: &[u8]) {
    let wanted = match reply {
        [.., b'0', _, _, _] => Some(false),
        [.., b'1', _, _, _] => Some(true),
        _ => None,
    };
    assert_eq!(driver::sensor_level(reply).ok(), wanted);
}

fn line(text: &str) {
    let Ok(line) = driver::parse(text) else { return };
    assert!(text.len() <= MAX_LINE);
    let written = driver::write(&line).expect("what fits as it came fits as it is written");
    assert_eq!(driver::parse(&written), Ok(line));
}

fn align(mut events: &[u8]) {
    let (mut alignment, mut action) = Alignment::start();
    // Asking, searching, settling, back, forward, hardware mode.
    let most = 6 * usize::from(MAX_ATTEMPTS) + 1;
    let mut levels = Vec::new();
    for _ in 0..most {
        match &action {
            Action::Aligned => {
                let [.., before, back, _, _] = levels[..] else { panic!("aligned without four waits") };
                assert_ne!(before, back, "aligned without a confirmed edge");
                return;
            }
            Action::Failed(_) => return,
            Action::Ask { line, first_ms, quiet_ms, total_ms } => {
                assert!(driver::write(line).is_ok() && !line.is_empty());
                assert!(*first_ms > 0 && *quiet_ms > 0 && (*first_ms..=20_000).contains(total_ms));
                levels.clear();
            }
            Action::Do { line, wait_ms } => assert!(driver::write(line).is_ok() && *wait_ms > 0),
        }
        let (kind, rest) = events.split_first().map_or((0, events), |(kind, rest)| (*kind, rest));
        events = rest;
        action = match kind & 3 {
            0 => alignment.next(Event::Silence),
            1 | 2 => {
                levels.push(kind & 3 == 1);
                alignment.next(Event::Waited(kind & 3 == 1))
            }
            _ => {
                let (reply, rest) = events.split_at(events.len().min(usize::from(kind >> 2)));
                events = rest;
                alignment.next(Event::Reply(reply))
            }
        };
    }
    assert!(matches!(action, Action::Aligned | Action::Failed(_)), "alignment has to end: {action:?}");
}
