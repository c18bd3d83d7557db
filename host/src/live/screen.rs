//! The live view as a screen of a terminal.

use crate::record::decode::LinkStatistics;
use crate::record::live::{LiveView, Point, SHOWN_US};
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Axis, Block, Chart, Dataset, GraphType, Paragraph};

/// Events shown.
const EVENTS: usize = 4;

/// Draws everything; `heading` says what is watched, `link` what the line lost.
pub fn draw(view: &LiveView, frame: &mut Frame, heading: &str, link: LinkStatistics) {
    let [head, values, position, speed, log] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Length(4),
        Constraint::Fill(3),
        Constraint::Fill(2),
        Constraint::Length(6),
    ])
    .areas(frame.area());
    let bold = Style::new().add_modifier(Modifier::BOLD);
    frame.render_widget(Line::from(vec![Span::styled(heading, bold), Span::raw("   q quits")]), head);
    frame.render_widget(numbers(view, link), values);
    draw_position(view, frame, position);
    draw_speed(view, frame, speed);
    let notes: Vec<&str> = view.notes_after(0).0.collect();
    let lines: Vec<Line> = notes[notes.len().saturating_sub(EVENTS)..].iter().map(|line| Line::raw(*line)).collect();
    frame.render_widget(Paragraph::new(lines).block(Block::bordered().title("events")), log);
}

fn numbers(view: &LiveView, link: LinkStatistics) -> Paragraph<'static> {
    let state = match (view.fault(), view.mode()) {
        (Some(fault), _) => Span::styled(format!("FAULT {fault:?}"), Style::new().fg(Color::Red)),
        (None, Some(mode)) => Span::raw(format!("{mode:?}")),
        (None, None) => Span::raw("nothing heard yet"),
    };
    let target = view.target().map_or("      -".to_owned(), |target| format!("{:7.1}", view.degrees(target)));
    let lost = format!(
        "lost: {} frames on the line, {} items on the board   late ticks: {}",
        link.missing_sequences,
        view.lost_items(),
        view.late_ticks()
    );
    let is_lossless = link.missing_sequences == 0 && link.broken_frames == 0 && view.lost_items() == 0;
    let lost_style = if is_lossless { Style::new() } else { Style::new().fg(Color::Yellow) };
    let position = view.position_deg();
    Paragraph::new(vec![
        Line::from(vec![
            Span::raw(format!(
                "target {target}°   position {position:7.1}°   speed {:6.1} rpm   duty {:+.3}   ",
                view.speed_rpm(),
                // No -0.000 of a motor that is off.
                view.duty() + 0.0
            )),
            state,
        ]),
        Line::from(Span::styled(lost, lost_style)),
    ])
    .block(Block::bordered())
}

fn draw_position(view: &LiveView, frame: &mut Frame, area: Rect) {
    let now = view.now_us();
    let at = |point: &Point| (point.time_us as f64 - now as f64) * 1e-6;
    let position: Vec<(f64, f64)> = view.history().map(|point| (at(point), point.position_deg)).collect();
    let target: Vec<(f64, f64)> = view.history().filter_map(|point| Some((at(point), point.target_deg?))).collect();
    let lines = [("target", &target, Color::Blue), ("position", &position, Color::Yellow)];
    draw_chart(frame, area, "target (blue), position (yellow), ° from the board's zero", &lines);
}

fn draw_speed(view: &LiveView, frame: &mut Frame, area: Rect) {
    let now = view.now_us();
    let at = |point: &Point| (point.time_us as f64 - now as f64) * 1e-6;
    let speed: Vec<(f64, f64)> = view.history().map(|point| (at(point), point.speed_rpm)).collect();
    let duty: Vec<(f64, f64)> = view.history().map(|point| (at(point), 100.0 * point.duty)).collect();
    let lines = [("speed (rpm)", &speed, Color::Green), ("duty (%)", &duty, Color::Magenta)];
    draw_chart(frame, area, "speed (green), rpm; duty (magenta), %", &lines);
}

type Curve<'a> = (&'a str, &'a Vec<(f64, f64)>, Color);

fn draw_chart(frame: &mut Frame, area: Rect, title: &str, curves: &[Curve<'_>]) {
    let values = || curves.iter().flat_map(|curve| curve.1.iter().map(|point| point.1));
    let low = values().fold(f64::INFINITY, f64::min).min(0.0);
    let high = values().fold(f64::NEG_INFINITY, f64::max).max(low + 1.0);
    let span_s = SHOWN_US as f64 * 1e-6;
    let datasets = curves.iter().map(|(name, points, color)| {
        Dataset::default()
            .name(*name)
            .marker(Marker::Braille)
            .graph_type(GraphType::Line)
            .style(Style::new().fg(*color))
            .data(points)
    });
    let chart = Chart::new(datasets.collect())
        .block(Block::bordered().title(title.to_owned()))
        .x_axis(Axis::default().bounds([-span_s, 0.0]).labels([format!("-{span_s:.0} s"), "now".to_owned()]))
        .y_axis(Axis::default().bounds([low, high]).labels([format!("{low:.0}"), format!("{high:.0}")]));
    frame.render_widget(chart, area);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::synthetic::{configured, control_blocks};
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;
    use twum_shared::Fault;
    use twum_shared::message::{DeviceMessage, FaultReport};
    use twum_shared::step::ConfigSpec;

    fn screen(view: &LiveView) -> String {
        let mut terminal = Terminal::new(TestBackend::new(120, 40)).unwrap();
        terminal.draw(|frame| draw(view, frame, "test", LinkStatistics::default())).unwrap();
        terminal.backend().to_string()
    }

    #[test]
    fn values_and_faults_stand_on_the_screen() {
        let mut view = LiveView::new();
        assert!(screen(&view).contains("nothing heard yet"));
        view.observe(0, &configured(ConfigSpec::THESIS));
        let blocks = control_blocks(ConfigSpec::THESIS, 0, 200);
        for block in &blocks {
            view.observe(block.first_us + 8000, &DeviceMessage::Control(block.clone()));
        }
        let last = blocks.last().unwrap().samples.last().unwrap();
        let shown = screen(&view);
        assert!(shown.contains(&format!("target {:7.1}°", f64::from(last.target) * 0.9)), "{shown}");
        assert!(shown.contains(&format!("position {:7.1}°", f64::from(last.position) * 0.9)), "{shown}");
        let report = FaultReport { fault: Fault::EncoderStall, off_us: 1, position: 0 };
        view.observe(2_000_000, &DeviceMessage::Fault(report));
        assert!(screen(&view).contains("FAULT EncoderStall"));
    }
}
