use super::*;
use std::sync::TryLockError;

/// Longer than a thread takes to come to a lock.
const COMES_TO_IT: Duration = Duration::from_millis(100);

fn owner() -> Arc<Owner> {
    let stop = Box::leak(Box::new(AtomicBool::new(false)));
    let board = Arc::new(Board::new("a port"));
    Arc::new(Owner { desk: Mutex::default(), board, holder: Arc::default(), stop, quit: AtomicBool::new(false) })
}

fn ended(words: &str) -> Ended {
    Ended { recording: None, ok: true, words: words.to_owned() }
}

/// What `ends` tells is told under the desk's lock: while the board's is held, nobody can come between.
fn is_told_and_free_as_one(owner: &Arc<Owner>, ends: impl FnOnce() + Send + 'static) {
    let held = owner.board.held();
    let telling = std::thread::spawn(ends);
    std::thread::sleep(COMES_TO_IT);
    assert!(matches!(owner.desk.try_lock(), Err(TryLockError::WouldBlock)), "free before the end is told");
    drop(held);
    telling.join().unwrap();
    assert_eq!(owner.board.state().last, Some(ended("over")));
}

/// Fails when the end is told before the next thing can be asked for, or after somebody may have asked for it.
#[test]
fn an_end_is_told_when_the_next_thing_can_be_asked_for() {
    let owner = owner();
    let first = owner.ask(Command::Align).unwrap();
    let (_, asked) = owner.take().unwrap();
    assert!(owner.ask(Command::Align).is_err(), "it is busy");
    let same = Arc::clone(&owner);
    is_told_and_free_as_one(&owner, move || {
        same.is_free_again(Last { ended: Some(ended("over")), answer: Some((asked, Ok(json!(true)))) });
    });
    assert_eq!(first.blocking_recv().unwrap(), Ok(json!(true)));

    let aside = owner.set_aside().unwrap();
    assert!(owner.set_aside().is_err(), "one thing at a time");
    is_told_and_free_as_one(&owner, move || aside.ends(ended("over")));

    // What is set aside next is not ended by what was before it: it can be stopped.
    let next = owner.set_aside().unwrap();
    let _answer = owner.stop();
    assert!(next.is_stopped());
}

/// Fails when who asked is told "accepted" before the page shows what goes on.
#[test]
fn what_is_accepted_is_shown_first() {
    let owner = owner();
    let mut answer = owner.ask(Command::Align).unwrap();
    let (_, asked) = owner.take().unwrap();
    let held = owner.board.held();
    let same = Arc::clone(&owner);
    let beginning = std::thread::spawn(move || same.begins(Doing::new("aligning".to_owned()), asked));
    std::thread::sleep(COMES_TO_IT);
    assert!(answer.try_recv().is_err(), "accepted before it is shown");
    drop(held);
    beginning.join().unwrap();
    assert!(answer.try_recv().unwrap().is_ok());
    assert_eq!(owner.board.state().doing.unwrap().what, "aligning");
}
