use super::*;
use proptest::prelude::*;
use std::fs;
use tempfile::TempDir;

fn folder(manifest: &str, files: &[(&str, &[u8])]) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join(MANIFEST), manifest).unwrap();
    for (name, content) in files {
        fs::write(dir.path().join(name), content).unwrap();
    }
    dir
}

fn one_run(format: &str, content: &[u8]) -> TempDir {
    let manifest = format!(
        "name = \"n\"\nmotor = \"pcbmotor-30mm\"\nedges_per_rev = 400\n[[run]]\nid = \"a\"\nkind = \"speed\"\nfile = \"a.csv\"\nformat = \"{format}\"\n"
    );
    folder(&manifest, &[("a.csv", content)])
}

fn data(format: &str, content: &[u8]) -> Result<RunData, MeasurementError> {
    Ok(Measurement::load(one_run(format, content).path())?.runs.remove(0).data)
}

/// The error of a data file as `line:column: message`.
fn refusal(format: &str, content: &[u8]) -> String {
    let error = data(format, content).unwrap_err();
    match &error {
        MeasurementError::At { path, line, column, message } => {
            assert!(path.ends_with("a.csv"), "{error}");
            format!("{line}:{column}: {message}")
        }
        other => panic!("{other}"),
    }
}

#[test]
fn packed_words_get_their_leading_zeros_back_and_come_first_sample_first() {
    let RunData::Levels { start_us, period_us, levels } =
        data("packed", b"101\r\n\r\n11111111111111111111111111111110\n").unwrap()
    else {
        panic!()
    };
    assert_eq!((start_us, period_us, levels.len()), (0.0, 1000.0, 64));
    let high: Vec<usize> = (0..64).filter(|i| levels[*i]).collect();
    let expected: Vec<usize> = [29, 31].into_iter().chain(32..63).collect();
    assert_eq!(high, expected);
}

#[test]
fn packed_refuses_what_the_capture_did_not_mean_as_samples() {
    assert!(refusal("packed", b"1\n012\n").starts_with("2:3: `2` is not a binary digit"));
    assert!(refusal("packed", &[b'1'; 33]).starts_with("1:33: 33 digits"));
    assert!(
        refusal("packed", b"1\nERROR: Reading not placed in queue.\n0\n")
            .starts_with("2:1: the capture reports a lost word")
    );
    assert!(refusal("packed", b"# nothing\n\n").contains("holds no word"));
}

#[test]
fn a_packed_record_that_ended_by_its_own_rule_says_so() {
    let stopped = |words: &str| {
        let dir = one_run("packed", words.as_bytes());
        Measurement::load(dir.path()).unwrap().runs[0].stopped_by_equal_words()
    };
    assert!(stopped("101\n11\n11\n11\n11\n11\n"));
    assert!(!stopped("101\n11\n11\n11\n11\n"));
}

#[test]
fn the_duty_in_a_thesis_file_name_is_the_high_fraction_of_an_active_low_pin() {
    for (name, on) in
        [("Duty_0_0.txt", 1.0), ("Duty_05_3.txt", 0.5), ("Duty_093_1.txt", 2.0 / 32.0), ("Duty_01_4.txt", 29.0 / 32.0)]
    {
        assert_eq!(packed::duty_from_name(name).map(|(duty, _)| duty), Some(on), "{name}");
    }
    assert_eq!(packed::duty_from_name("Duty_9_1.txt"), None);
    assert_eq!(packed::duty_from_name("speed.csv"), None);
}

#[test]
fn a_folder_of_thesis_texts_loads_without_a_manifest() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("Duty_03_1.txt"), "1\n").unwrap();
    fs::write(dir.path().join("Duty_03_0.txt"), "11\n").unwrap();
    fs::write(dir.path().join("notes.txt"), "hello").unwrap();
    let loaded = Measurement::load_thesis_texts(dir.path(), Direction::Ccw).unwrap();
    let ids: Vec<&str> = loaded.runs.iter().map(|run| run.id.as_str()).collect();
    assert_eq!(ids, ["Duty_03_0", "Duty_03_1"]);
    assert_eq!(loaded.runs[0].duty, Some(1.0 - 10.0 / 32.0));
    assert_eq!(loaded.runs[0].direction, Some(Direction::Ccw));
}

#[test]
fn levels_are_a_grid_and_a_hole_in_it_is_named() {
    let RunData::Levels { start_us, period_us, levels } =
        data("levels", b"# bench 3\ntime_us,level\n500,0\n 1500 , 1\n2500,1.0\n").unwrap()
    else {
        panic!()
    };
    assert_eq!((start_us, period_us, levels), (500.0, 1000.0, vec![false, true, true]));
    let mut text = "time_us,level\n".to_owned();
    for i in 0..100 {
        text += &format!("{},0\n", 1000 * i + if i >= 50 { 32_000 } else { 0 });
    }
    assert!(refusal("levels", text.as_bytes()).contains("not on a regular grid"));
    assert!(refusal("levels", b"time_us,level\n0,0\n").contains("at least two rows"));
    assert!(refusal("levels", b"time_us,level\n0,0\n1,2\n").starts_with("3:3: level `2`"));
    // A third of a millisecond, rounded to whole µs, is still a grid.
    assert!(data("levels", b"time_us,level\n0,0\n333,0\n667,1\n1000,1\n").is_ok());
}

#[test]
fn edges_alternate_between_a_first_and_a_last_row() {
    let edge = |time_us, level| LevelEdge { time_us, level };
    let read = data("edges", b"time_us,level\n0,1\n10.5,0\n20,1\n30,1\n").unwrap();
    let expected =
        RunData::Edges { initial: true, start_us: 0.0, edges: vec![edge(10.5, false), edge(20.0, true)], end_us: 30.0 };
    assert_eq!(read, expected);
    assert!(refusal("edges", b"time_us,level\n0,1\n10,1\n20,0\n").starts_with("4:1: the row before repeats"));
    assert!(refusal("edges", b"time_us,level\n0,1\n").contains("a first and a last row"));
}

#[test]
fn errors_of_tables_name_line_and_column() {
    assert!(refusal("velocity", b"time_us,speed\n").starts_with("1:1: expected the header `time_us,rpm`"));
    assert!(refusal("velocity", b"").contains("the file is empty"));
    assert!(refusal("velocity", b"time_us,rpm\n0,1\n1,nan\n").starts_with("3:3: rpm is not finite"));
    assert!(refusal("velocity", b"time_us,rpm\n0,1\n1, x\n").starts_with("3:4: rpm `x` is not a number"));
    assert!(refusal("velocity", b"time_us,rpm\n0,1\n0,2\n").starts_with("3:1: time_us 0 does not come after 0"));
    assert!(refusal("velocity", b"time_us,rpm\n0,1\n1\n").starts_with("3:2: 1 of 2 columns"));
    assert!(refusal("velocity", b"time_us,rpm\n0,1,2\n").starts_with("2:5: more than the 2 columns"));
    assert!(refusal("velocity", b"time_us,rpm\n0,1\n9e10,1\n").contains("24 hours"));
    assert!(
        refusal("velocity", b"time_us,rpm\n0,1\n1,-1e300\n").starts_with("3:3: -1e300 rpm: no motor turns that fast")
    );
    assert!(refusal("velocity", &[b'x'; 5000]).contains("line longer than"));
    assert!(
        refusal("control", b"time_us,target,position,u,duty,direction\n0,0,0,0,50,1\n").starts_with("2:9: duty 50")
    );
    assert!(
        refusal("control", b"time_us,target,position,u,duty,direction\n0,0,0,0,0.5,0\n")
            .starts_with("2:13: direction 0")
    );
}

#[test]
fn errors_of_the_manifest_name_line_and_column() {
    let base = "name = \"n\"\nmotor = \"pcbmotor-30mm\"\nedges_per_rev = 400\n[[run]]\nid = \"a\"\nkind = \"speed\"\nfile = \"a.csv\"\nformat = \"velocity\"\n";
    let refusal = |manifest: &str| {
        let dir = folder(manifest, &[("a.csv", b"time_us,rpm\n0,0\n1,1\n")]);
        match Measurement::load(dir.path()).unwrap_err() {
            MeasurementError::At { line, column, message, .. } => format!("{line}:{column}: {message}"),
            other => panic!("{other}"),
        }
    };
    assert!(refusal(&format!("{base}dutty = 0.5\n")).starts_with("9:1: unknown field `dutty`"));
    assert!(refusal(&format!("{base}duty = 50\n")).starts_with("9:8: duty 50"));
    assert!(refusal(&format!("{base}pwm_hz = 0.0\n")).starts_with("9:10: pwm_hz"));
    assert!(refusal(&format!("{base}control = \"pid\"\n")).starts_with("9:11: control"));
    assert!(refusal(&format!("{base}control = {{ kp = 1.0 }}\n")).contains("missing field"));
    assert!(refusal(&base.replace("velocity", "speed")).starts_with("8:10: unknown variant `speed`"));
    assert!(
        refusal(&format!("{base}{}", &base[base.find("[[run]]").unwrap()..]))
            .starts_with("10:6: id `a` names two runs")
    );
    assert!(refusal("name = \"n\"\nmotor = \"m\"\n").contains("no [[run]]"));
    assert!(
        refusal(
            &base.replace("edges_per_rev = 400\n", "").replace("pcbmotor-30mm", "mine").replace("velocity", "levels")
        )
        .contains("edges_per_rev is missing")
    );
}

#[test]
fn files_named_in_the_manifest_stay_inside_the_folder() {
    let outside = tempfile::tempdir().unwrap();
    fs::write(outside.path().join("a.csv"), "time_us,rpm\n0,0\n1,1\n").unwrap();
    let absolute = outside.path().join("a.csv").display().to_string();
    for name in ["../a.csv", absolute.as_str(), "x/../../a.csv", "link.csv", "", "..", "dir/a.csv"] {
        let manifest = format!(
            "name = \"n\"\nmotor = \"pcbmotor-30mm\"\n[[run]]\nid = \"a\"\nkind = \"speed\"\nfile = \"{name}\"\nformat = \"velocity\"\n"
        );
        let dir = folder(&manifest, &[]);
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(&absolute, dir.path().join("link.csv")).unwrap();
            std::os::unix::fs::symlink(outside.path(), dir.path().join("dir")).unwrap();
        }
        let error = Measurement::load(dir.path()).unwrap_err().to_string();
        assert!(error.contains("measurement.toml:6:8: file:"), "{name}: {error}");
    }
    let motor = "name = \"n\"\nmotor = \"../motor.toml\"\n[[run]]\nid = \"a\"\nkind = \"speed\"\nfile = \"a.csv\"\nformat = \"velocity\"\n";
    let error = Measurement::load(folder(motor, &[]).path()).unwrap_err().to_string();
    assert!(error.contains("measurement.toml:2:9: motor:"), "{error}");
}

#[test]
#[ignore = "needs measured data: .ci/run measured"]
fn the_measured_examples_load() {
    let data = PathBuf::from(std::env::var_os("TWUM_DATA").expect("TWUM_DATA names the folder of measured data"));
    let speed = Measurement::load(data.join("twum-speed")).unwrap();
    let RunData::Velocity { time_us, rpm } = &speed.runs[0].data else { panic!() };
    assert_eq!((time_us.len(), rpm[3], speed.runs[0].duty), (3350, 11.15, Some(1.0)));
    let wheels = Measurement::load(data.join("micromouse")).unwrap();
    assert_eq!(wheels.runs.len(), 2);
    let RunData::Drive { input, response: DriveResponse::SpeedRpm(rpm), .. } = &wheels.runs[1].data else { panic!() };
    assert_eq!((input[0], rpm[0]), (-254.0, -648.33));
}

/// Fails if a unit is taken for another, or a column without one is taken for anything.
#[test]
fn an_ordinary_motors_units_are_those_the_folder_names() {
    let loaded = |units: &str, header: &str| {
        let manifest = format!(
            "name = \"n\"\nmotor = \"inertial\"\n{units}\n[[run]]\nid = \"a\"\nkind = \"speed\"\nfile = \"a.csv\"\nformat = \"drive\"\n"
        );
        let dir = folder(&manifest, &[("a.csv", format!("{header}\n0,0,0\n2,0.5,36\n").as_bytes())]);
        Measurement::load(dir.path()).map(|mut m| m.runs.remove(0).data).map_err(|e| e.to_string())
    };
    let tau = std::f64::consts::TAU;
    for (units, header, last_us, last) in [
        ("time_unit = \"ms\"\nspeed_unit = \"rad/s\"\ninput_unit = \"V\"", "time,input,speed", 2e3, 36.0 * 60.0 / tau),
        ("time_unit = \"s\"\nspeed_unit = \"deg/s\"", "time,input,speed", 2e6, 6.0),
        ("speed_unit = \"turns/s\"", "time_us,input,speed", 2.0, 2160.0),
        ("speed_unit = \"counts/s\"\ncounts_per_turn = 72", "time_us,input,speed", 2.0, 30.0),
        ("speed_unit = \"mm/s\"\nmm_per_turn = 5", "time_us,input,speed", 2.0, 432.0),
        ("position_unit = \"deg\"", "time_us,input,position", 2.0, tau / 10.0),
        ("position_unit = \"counts\"\ncounts_per_turn = 144", "time_us,input,position", 2.0, tau / 4.0),
        ("position_unit = \"m\"\nmm_per_turn = 72000", "time_us,input,position", 2.0, tau / 2.0),
        ("position_unit = \"turns\"\ntime_unit = \"ms\"", "time,input,position_rad", 2e3, 36.0),
    ] {
        let RunData::Drive { time_us, input, response, .. } = loaded(units, header).unwrap() else { panic!() };
        let (DriveResponse::SpeedRpm(values) | DriveResponse::PositionRad(values)) = response;
        assert_eq!((time_us[1], input[1]), (last_us, 0.5), "{units}");
        assert!((values[1] / last - 1.0).abs() < 1e-12, "{units}: {}", values[1]);
    }
    for (units, header, word) in [
        ("", "time,input,speed_rpm", "time_unit"),
        ("", "time_us,input,speed", "speed_unit"),
        ("", "time_us,input,position", "position_unit"),
        ("speed_unit = \"m/s\"", "time_us,input,speed", "mm_per_turn"),
        ("position_unit = \"counts\"", "time_us,input,position", "counts_per_turn"),
        ("position_unit = \"mm\"\nmm_per_turn = 0", "time_us,input,position", "mm_per_turn 0 is not above 0"),
        ("time_unit = \"minutes\"", "time,input,speed_rpm", "minutes"),
    ] {
        let error = loaded(units, header).unwrap_err();
        assert!(error.contains(word), "{units}, {header}: {error}");
    }
}

/// Fails if a column beside the motion is taken for another, or one that is not known is read over.
#[test]
fn columns_beside_the_motion_are_read_by_their_names() {
    let loaded = |header: &str, row: &str| {
        let manifest = "name = \"n\"\nmotor = \"inertial\"\n[[run]]\nid = \"a\"\nkind = \"speed\"\nfile = \"a.csv\"\nformat = \"drive\"\n";
        let dir = folder(manifest, &[("a.csv", format!("{header}\n{row}\n2{}\n", &row[1..]).as_bytes())]);
        Measurement::load(dir.path()).map(|mut m| m.runs.remove(0).data).map_err(|e| e.to_string())
    };
    let header = "time_us,input,speed_rpm,temperature,load,current,reference";
    let RunData::Drive { input, beside, .. } = loaded(header, "0,1,2,21.5,0.3,4,7").unwrap() else { panic!() };
    assert_eq!(input, [1.0, 1.0]);
    for (column, value) in
        [(Beside::Temperature, 21.5), (Beside::Load, 0.3), (Beside::Current, 4.0), (Beside::Reference, 7.0)]
    {
        assert_eq!(beside[&column], [value; 2], "{}", column.name());
    }
    let RunData::Drive { input, beside, .. } = loaded("time_us,current,speed_rpm,load", "0,1,2,3").unwrap() else {
        panic!()
    };
    assert_eq!((input, beside.len()), (vec![1.0; 2], 1));
    for (header, row, word) in [
        ("time_us,input,speed_rpm,torque", "0,1,2,3", "`temperature`, found `time_us,input,speed_rpm,torque`"),
        ("time_us,input,speed_rpm,load,load", "0,1,2,3,4", "`load` is there twice"),
        ("time_us,current,speed_rpm,current", "0,1,2,3", "`current` is there twice"),
        ("time_us,input,speed_rpm,load", "0,1,2,x", "load `x` is not a number"),
        ("time_us,input,speed_rpm,load", "0,1,2", "3 of 4 columns"),
        ("time_us,input", "0,1", "expected the header"),
    ] {
        let error = loaded(header, row).unwrap_err();
        assert!(error.contains(word), "{header}: {error}");
    }
}

fn times(count: usize) -> impl Strategy<Value = Vec<f64>> {
    (-1e9..1e9, prop::collection::vec(0.001..1e6f64, count)).prop_map(|(start, steps)| {
        steps
            .into_iter()
            .scan(start, |now: &mut f64, step| {
                *now += step;
                Some(*now)
            })
            .collect()
    })
}

fn any_data() -> impl Strategy<Value = RunData> {
    let levels = (-1_000_000i32..1_000_000, 1u32..100_000, prop::collection::vec(any::<bool>(), 2..200)).prop_map(
        |(start, period, levels)| RunData::Levels { start_us: start.into(), period_us: period.into(), levels },
    );
    let edges = (any::<bool>(), (2usize..60).prop_flat_map(times)).prop_map(|(initial, times)| {
        let inner = &times[1..times.len() - 1];
        let edges = inner
            .iter()
            .enumerate()
            .map(|(i, time_us)| LevelEdge { time_us: *time_us, level: initial ^ (i % 2 == 0) })
            .collect();
        RunData::Edges { initial, start_us: times[0], edges, end_us: times[times.len() - 1] }
    });
    let value = -1e12..1e12f64;
    let series = (2usize..60).prop_flat_map(move |n| {
        (times(n), prop::collection::vec(value.clone(), n), prop::collection::vec(value.clone(), n))
    });
    let velocity = series.clone().prop_map(|(time_us, mut rpm, _)| {
        // No faster than a table may say.
        rpm.iter_mut().for_each(|v| *v *= 1e-5);
        RunData::Velocity { time_us, rpm }
    });
    let columns = prop::collection::btree_set(prop::sample::select(Beside::ALL.to_vec()), 0..=Beside::ALL.len());
    let drive =
        (series, any::<bool>(), columns).prop_map(|((time_us, input, values), speed, columns)| RunData::Drive {
            beside: columns.into_iter().map(|c| (c, input.iter().map(|v| v * 1e-3).collect())).collect(),
            time_us,
            input,
            response: if speed { DriveResponse::SpeedRpm(values) } else { DriveResponse::PositionRad(values) },
        });
    let control = (2usize..40)
        .prop_flat_map(|n| {
            let row = (-1_000_000..1_000_000i32, -1_000_000..1_000_000i32, -1e4..1e4f64, 0.0..=1.0f64, any::<bool>());
            (times(n), prop::collection::vec(row, n))
        })
        .prop_map(|(times, rows)| {
            let row = |(time_us, (target, position, u, duty, cw)): (f64, (i32, i32, f64, f64, bool))| ControlRow {
                time_us,
                target: target.into(),
                position: position.into(),
                u,
                duty,
                direction: if cw { Direction::Cw } else { Direction::Ccw },
            };
            RunData::Control(times.into_iter().zip(rows).map(row).collect())
        });
    prop_oneof![levels, edges, velocity, drive, control]
}

fn any_run() -> impl Strategy<Value = Run> {
    let control = prop_oneof![
        Just(None),
        Just(Some(ControlSpec::Thesis)),
        Just(Some(ControlSpec::Default)),
        (-9.0..9.0f64, 1u32..65_536, -5.0..0.0f64).prop_map(|(kp, duty_steps, integral_min)| Some(ControlSpec::Table(
            ControlGains { kp, ki: 0.1, kd: 1e-5, period_us: 500.0, duty_steps, integral_min, integral_max: 31.0 }
        ))),
    ];
    let direction = prop_oneof![Just(None), Just(Some(Direction::Cw)), Just(Some(Direction::Ccw))];
    let options =
        (prop::option::of(0.0..=1.0f64), direction, 0.01..1e5f64, prop::option::of(0.0..100.0f64), -1.0..1.0f64);
    ("[a-zA-Z/. é\"-]{1,8}", any_data(), options, any::<(bool, Option<u32>, bool)>(), control).prop_map(
        |(id, data, (duty, direction, pwm_hz, drive_on_s, pwm_phase_s), (aligned, order, track), control)| Run {
            duty,
            direction,
            pwm_hz,
            drive_on_s,
            pwm_phase_s,
            aligned,
            order,
            control,
            ..Run::new(id, if track { RunKind::Track } else { RunKind::Speed }, data)
        },
    )
}

/// Any run file and any manifest, whole or damaged, either loads or is refused: never a panic.
fn damaged(text: &[u8], at: prop::sample::Index, damage: Damage) -> Vec<u8> {
    let mut bytes = text.to_vec();
    let at = at.index(bytes.len());
    match damage {
        Damage::Cut => bytes.truncate(at),
        Damage::Set(byte) => bytes[at] = byte,
        Damage::Insert(insert) => drop(bytes.splice(at..at, insert)),
        Damage::Double => {
            let copy = bytes[at..].to_vec();
            bytes.extend(copy);
        }
    }
    bytes
}

#[derive(Debug, Clone)]
enum Damage {
    Cut,
    Set(u8),
    Insert(Vec<u8>),
    Double,
}

fn any_damage() -> impl Strategy<Value = Damage> {
    prop_oneof![
        Just(Damage::Cut),
        any::<u8>().prop_map(Damage::Set),
        prop::collection::vec(any::<u8>(), 1..20).prop_map(Damage::Insert),
        "[0-9eE.,+-]{1,20}".prop_map(|text| Damage::Insert(text.into_bytes())),
        Just(Damage::Double),
    ]
}

proptest! {
    #[test]
    fn what_is_saved_loads_as_it_was(mut runs in prop::collection::vec(any_run(), 1..5), edges in 1u32..10_000) {
        for (index, run) in runs.iter_mut().enumerate() {
            run.id = format!("{}{index}", run.id);
        }
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("new");
        let original = Measurement { name: "n \"é\"".into(), motor: "x".into(), edges_per_rev: edges, runs, folder: dir.path().into() };
        let mut loaded = original.save(&folder).unwrap();
        prop_assert_eq!(&loaded, &Measurement::load(&folder).unwrap());
        loaded.folder = original.folder.clone();
        for (run, source) in loaded.runs.iter_mut().zip(&original.runs) {
            run.file = source.file.clone();
        }
        prop_assert_eq!(&loaded, &original);
        prop_assert!(original.save(&folder).is_err(), "saved over an existing folder");
    }

    #[test]
    fn damaged_folders_load_or_are_refused(run in any_run(), in_manifest: bool, at: prop::sample::Index, damage in any_damage()) {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("new");
        let saved = Measurement { name: "n".into(), motor: "x".into(), edges_per_rev: 4, runs: vec![run], folder: dir.path().into() }
            .save(&folder).unwrap();
        let path = folder.join(if in_manifest { MANIFEST } else { &saved.runs[0].file });
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, damaged(&bytes, at, damage)).unwrap();
        if let Err(error) = Measurement::load(&folder) {
            prop_assert!(error.to_string().contains(":") && error.to_string().contains("new"), "{}", error);
        }
    }

    #[test]
    fn arbitrary_bytes_are_refused_or_read(format in "levels|edges|packed|velocity|control|drive", bytes: Vec<u8>) {
        let _ = data(&format, &bytes);
    }
}
