//! Pictures of sessions: the end point's trajectory, reference and true, as in the thesis's Figure 5.12, and the errors.

use crate::neck::kinematics::JOINTS;
use crate::neck::session::Session;
use crate::report::figure::{Figure, Panel};

/// Time between the points drawn, s.
const STEP_S: f64 = 0.01;

/// A column an exercise: the trajectory from the side, the front and above, the end point's error, the joints' errors.
pub fn figure(sessions: &[&Session]) -> Figure {
    let height = 60 + 300 * 5;
    let figure = Figure::new("End point of the neck manipulator: reference and true")
        .size(60 + 340 * (sessions.len().max(2) as u32), height)
        .columns(sessions.len());
    let rows = [side, front, above, end_point_error, joint_errors];
    rows.into_iter().flat_map(|row| sessions.iter().map(move |session| row(session))).fold(figure, Figure::panel)
}

/// The errors of one session: of the end point, and of the joints.
pub(super) fn errors(session: &Session) -> Figure {
    Figure::new("").panel(end_point_error(session)).panel(joint_errors(session))
}

fn side(session: &Session) -> Panel {
    plane(session, ("y, forward (m)", 1), ("z, up (m)", 2)).title(session.exercise.title().to_owned())
}

fn front(session: &Session) -> Panel {
    plane(session, ("x, to the right (m)", 0), ("z, up (m)", 2))
}

fn above(session: &Session) -> Panel {
    plane(session, ("x, to the right (m)", 0), ("y, forward (m)", 1))
}

fn plane(session: &Session, (x_label, x): (&str, usize), (y_label, y): (&str, usize)) -> Panel {
    let reach = 1.1 * session.wrist.length_m;
    let (low, high) = if y == 2 { (-0.2 * reach, reach) } else { (-reach, reach) };
    let trajectory = |pose: fn(&Session, usize) -> [f64; JOINTS]| -> Vec<(f64, f64)> {
        ticks(session)
            .map(|tick| {
                let point = session.wrist.end_point_m(pose(session, tick));
                (point[x], point[y])
            })
            .collect()
    };
    Panel::new(x_label, y_label)
        .x_range(-reach, reach)
        .y_range(low, high)
        .line("true", &trajectory(Session::joints_deg))
        .dashed("reference", &trajectory(Session::reference_deg))
}

fn end_point_error(session: &Session) -> Panel {
    Panel::new("time (s)", "end-point error (mm)").line("", &worst(session, |tick| session.error_m(tick) * 1e3))
}

fn joint_errors(session: &Session) -> Panel {
    (0..JOINTS).fold(Panel::new("time (s)", "joint error (°)"), |panel, joint| {
        let error = |tick| session.joints_deg(tick)[joint] - session.reference_deg(tick)[joint];
        panel.line(format!("joint {}", joint + 1), &worst(session, error))
    })
}

/// The error largest in magnitude of every step: a peak between two points must not be lost.
fn worst(session: &Session, error: impl Fn(usize) -> f64) -> Vec<(f64, f64)> {
    let stride = stride(session);
    let step = |tick: usize| {
        let errors = (tick..(tick + stride).min(session.len())).map(&error);
        (session.time_s(tick), errors.fold(0.0, |worst: f64, e| if e.abs() > worst.abs() { e } else { worst }))
    };
    ticks(session).map(step).collect()
}

fn stride(session: &Session) -> usize {
    ((STEP_S / session.tick_s).round() as usize).max(1)
}

fn ticks(session: &Session) -> impl Iterator<Item = usize> + use<> {
    (0..session.len()).step_by(stride(session))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::neck::fixture::session;

    #[test]
    fn three_exercises_make_five_rows_of_three_panels() {
        let sessions = ["flexion-extension", "lateral-flexion", "rotation"].map(session);
        let svg = figure(&sessions.iter().collect::<Vec<_>>()).svg().unwrap();
        for label in ["Flexion–extension", "Lateral flexion", "Rotation"] {
            assert!(svg.contains(label), "{label}");
        }
        assert_eq!(svg.matches("end-point error (mm)").count(), 3);
        assert_eq!(svg.matches("joint error (°)").count(), 3);
    }
}
