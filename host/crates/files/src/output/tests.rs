use super::*;
use std::thread;
use tempfile::TempDir;

fn dir() -> TempDir {
    tempfile::tempdir().unwrap()
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn pictures_and_pages_are_replaced_and_data_only_where_the_user_said_so() {
    let dir = dir();
    for (name, replaced) in [("a.svg", true), ("a.PNG", true), ("a.html", true), ("a.csv", false), ("a", false)] {
        let path = dir.path().join(name);
        write(&path, "old", Existing::Keep).unwrap();
        match write(&path, "new", Existing::Keep) {
            Ok(()) => assert!(replaced, "{name}"),
            Err(error) => {
                assert!(!replaced && matches!(error, OutputError::Exists(_)), "{error}");
                assert!(may_write(&path, Existing::Keep).is_err());
                assert_eq!(fs::read(&path).unwrap(), b"old");
                write(&path, "new", Existing::Replace).unwrap();
            }
        }
        assert_eq!(fs::read(&path).unwrap(), b"new");
    }
    assert_eq!(names(dir.path()).len(), 5, "nothing is left beside them");
}

#[test]
fn what_is_not_finished_leaves_nothing_and_touches_nothing() {
    let dir = dir();
    let path = dir.path().join("page.html");
    write(&path, "old", Existing::Keep).unwrap();
    let mut out = Output::begin(&path, Existing::Keep).unwrap();
    out.write_all(&[b'x'; 1 << 20]).unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"old");
    drop(out);
    assert_eq!((names(dir.path()), fs::read(&path).unwrap()), (vec!["page.html".to_owned()], b"old".to_vec()));
}

#[test]
fn what_the_program_reads_is_never_written_onto() {
    let dir = dir();
    let input = dir.path().join("recording.mcap");
    fs::write(&input, "measured").unwrap();
    crate::input::bytes(&input, 100).unwrap();
    let mut others = vec![dir.path().join(".").join("recording.mcap")];
    #[cfg(unix)]
    {
        let link = dir.path().join("link.html");
        std::os::unix::fs::symlink(&input, &link).unwrap();
        others.push(link);
        let same = dir.path().join("same.svg");
        fs::hard_link(&input, &same).unwrap();
        others.push(same);
    }
    for path in others.iter().chain([&input]) {
        let error = write(path, "page", Existing::Replace).unwrap_err();
        assert!(matches!(error, OutputError::Input(_)), "{error}");
    }
    assert_eq!(fs::read(&input).unwrap(), b"measured");
}

#[cfg(unix)]
#[test]
fn a_link_that_was_there_is_followed_and_one_that_comes_later_is_not() {
    use std::os::unix::fs::symlink;
    let dir = dir();
    let (real, link) = (dir.path().join("real.html"), dir.path().join("link.html"));
    fs::write(&real, "old").unwrap();
    symlink(&real, &link).unwrap();
    write(&link, "new", Existing::Keep).unwrap();
    assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    assert_eq!(fs::read(&real).unwrap(), b"new");

    let late = dir.path().join("late.html");
    let out = Output::begin(&late, Existing::Keep).unwrap();
    symlink(&real, &late).unwrap();
    out.finish().unwrap();
    assert!(!fs::symlink_metadata(&late).unwrap().is_symlink());
    assert_eq!(fs::read(&real).unwrap(), b"new", "not through the link");

    let nowhere = dir.path().join("nowhere.html");
    symlink(dir.path().join("none"), &nowhere).unwrap();
    assert!(matches!(write(&nowhere, "x", Existing::Replace), Err(OutputError::Dangling(_))));
}

#[cfg(unix)]
#[test]
fn a_device_is_written_through_and_rights_are_those_of_any_new_file() {
    use std::os::unix::fs::PermissionsExt;
    write("/dev/null", "gone", Existing::Keep).unwrap();
    assert!(!fs::metadata("/dev/null").unwrap().is_file());
    let dir = dir();
    let (ours, theirs) = (dir.path().join("ours.csv"), dir.path().join("theirs.csv"));
    write(&ours, "x", Existing::Keep).unwrap();
    fs::write(&theirs, "x").unwrap();
    let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode();
    assert_eq!(mode(&ours), mode(&theirs));
    fs::set_permissions(&ours, fs::Permissions::from_mode(0o640)).unwrap();
    write(&ours, "y", Existing::Replace).unwrap();
    assert_eq!(mode(&ours) & 0o777, 0o640);
}

#[test]
fn of_writers_at_once_one_wins_whole() {
    let dir = dir();
    for (name, winners) in [("picture.svg", 8), ("table.csv", 1)] {
        let path = dir.path().join(name);
        let written: usize = thread::scope(|scope| {
            let writers: Vec<_> = (0..8u8)
                .map(|who| {
                    let path = &path;
                    scope.spawn(move || write(path, vec![b'a' + who; 300_000], Existing::Keep).is_ok())
                })
                .collect();
            writers.into_iter().map(|writer| usize::from(writer.join().unwrap())).sum()
        });
        assert_eq!(written, winners, "{name}");
        let bytes = fs::read(&path).unwrap();
        assert!(bytes.len() == 300_000 && bytes.iter().all(|byte| *byte == bytes[0]), "{name} is one writer's");
    }
    assert_eq!(names(dir.path()), ["picture.svg", "table.csv"]);
}

#[test]
fn a_folder_is_there_whole_or_not_at_all() {
    let dir = dir();
    let fill = |folder: &mut NewFolder| -> Result<(), OutputError> {
        folder.file("deep/a.csv", |out| out.write_all(b"1").map_err(|reason| out.failed(reason)))?;
        folder.file("b.csv", |out| out.write_all(b"2").map_err(|reason| out.failed(reason)))
    };
    let mut folder = NewFolder::begin(dir.path().join("new")).unwrap();
    fill(&mut folder).unwrap();
    assert!(!dir.path().join("new").exists());
    folder.finish().unwrap();
    assert_eq!(names(&dir.path().join("new")), ["b.csv", "deep"]);
    assert!(matches!(NewFolder::begin(dir.path().join("new")), Err(OutputError::Exists(_))));

    let empty = dir.path().join("empty");
    fs::create_dir(&empty).unwrap();
    let mut folder = NewFolder::begin(&empty).unwrap();
    fill(&mut folder).unwrap();
    drop(folder);
    assert_eq!(names(&empty), [""; 0], "given up: nothing stays");
    let mut folder = NewFolder::begin(&empty).unwrap();
    fill(&mut folder).unwrap();
    folder.finish().unwrap();
    assert_eq!(
        (names(&empty), fs::read(empty.join("deep/a.csv")).unwrap()),
        (names(&dir.path().join("new")), b"1".to_vec())
    );

    let taken = NewFolder::begin(dir.path().join("taken")).unwrap();
    fs::create_dir(dir.path().join("taken")).unwrap();
    fs::write(dir.path().join("taken/theirs"), "x").unwrap();
    assert!(matches!(taken.finish(), Err(OutputError::Exists(_))));
    assert_eq!(names(dir.path()), ["empty", "new", "taken"]);
}
