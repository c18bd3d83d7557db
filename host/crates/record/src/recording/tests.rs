use super::*;
use crate::synthetic::{Line, bits_block, configured, control_blocks, edges_block};
use twum_shared::step::ConfigSpec;

fn recorded(make: impl FnOnce(&mut Line)) -> Recording {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.mcap");
    let mut line = Line::new(&path);
    make(&mut line);
    line.finish();
    Recording::load(&path).unwrap()
}

#[test]
fn a_lost_frame_splits_the_signal_where_it_is_missing() {
    let recording = recorded(|line| {
        line.device(configured(ConfigSpec::THESIS));
        let blocks = control_blocks(ConfigSpec::THESIS, 1000, 5);
        for (index, block) in blocks.into_iter().enumerate() {
            line.now_us = block.first_us + 8000;
            match index {
                1 => line.lost(DeviceMessage::Control(block)),
                3 => line.broken(DeviceMessage::Control(block)),
                _ => line.device(DeviceMessage::Control(block)),
            }
        }
    });
    let ticks: Vec<(u64, u64, usize)> =
        recording.control.iter().map(|segment| (segment.first_tick, segment.first_us, segment.samples.len())).collect();
    assert_eq!(ticks, [(0, 1000, 16), (32, 17_000, 16), (64, 33_000, 16)]);
    let link = recording.link;
    assert_eq!((link.missing_sequences, link.gaps, link.broken_frames, link.sessions), (2, 2, 1, 1));
}

#[test]
fn consecutive_blocks_join() {
    let recording = recorded(|line| {
        for index in 0..3 {
            line.now_us = 64_000 * (index + 1);
            line.device(DeviceMessage::Bits(bits_block(64 * index, 1000 + 64_000 * index, 2)));
            line.device(DeviceMessage::Edges(edges_block(9 * index, 1000 + 63_000 * index, 9)));
        }
    });
    let [bits] = &recording.bits[..] else { panic!("{} segments", recording.bits.len()) };
    assert_eq!((bits.first_us, bits.levels.len()), (1000, 192));
    assert!((0..192).all(|sample| bits.levels[sample] == ((sample / 7) % 2 == 1)));
    let [edges] = &recording.edges[..] else { panic!() };
    assert_eq!((edges.edges.len(), edges.edges[26].time_us), (27, 1000 + 26 * 7000));
}

#[test]
fn an_edge_missing_without_a_word_shows_as_a_level_that_repeats() {
    let recording = recorded(|line| {
        line.now_us = 1_000_000;
        line.device(DeviceMessage::Edges(edges_block(0, 1000, 5)));
        let mut later = edges_block(6, 43_000, 5);
        later.first_edge = 5;
        line.device(DeviceMessage::Edges(later));
    });
    assert_eq!(recording.edges.len(), 2);
}

#[test]
fn edge_times_are_resolved_over_the_wrap_of_32_bits() {
    let recording = recorded(|line| {
        line.now_us = (1 << 32) + 5000;
        line.device(DeviceMessage::Edges(edges_block(0, (1 << 32) - 9000, 2)));
    });
    let times: Vec<u64> = recording.edges[0].edges.iter().map(|edge| edge.time_us).collect();
    assert_eq!(times, [(1 << 32) - 9000, (1 << 32) - 2000]);
}

#[test]
fn a_restart_of_the_board_begins_a_session() {
    let recording = recorded(|line| {
        line.now_us = 5_000_000;
        line.device(DeviceMessage::Aligned);
        line.device(DeviceMessage::Bits(bits_block(0, 4_000_000, 1)));
        line.restart();
        line.device(DeviceMessage::Bits(bits_block(32, 1000, 1)));
        line.device(DeviceMessage::RunStarted { start_us: 2000 });
    });
    assert_eq!(recording.link.sessions, 2);
    assert_eq!(recording.link.missing_sequences, 0);
    let sessions: Vec<u32> = recording.bits.iter().map(|segment| segment.session).collect();
    assert_eq!(sessions, [0, 1]);
    assert_eq!((recording.runs[0].session, recording.runs[0].aligned), (1, false));
}

#[test]
fn device_time_is_placed_on_the_hosts_clock() {
    let recording = recorded(|line| {
        line.now_us = 5_000_000;
        line.device(DeviceMessage::Aligned);
    });
    assert_eq!(recording.host_time_ns(0, 4_000_000), 4_000_300_000);
}
