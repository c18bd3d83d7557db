//! Two figures of the same quantities over each other.

use super::{Figure, Panel, Series, Shape};

impl Figure {
    /// The panels that both have, told apart by the names; each begins at x = 0.
    #[must_use]
    pub fn over(self, name: &str, other: Self, other_name: &str) -> Self {
        let mut others = other.panels;
        let panels = self.panels.into_iter().filter_map(|panel| {
            let same = others.iter().position(|it| it.y_label == panel.y_label && it.x_label == panel.x_label)?;
            let (mut one, two) = (panel.named(name), others.swap_remove(same).named(other_name));
            one.x_range = one.x_range.zip(two.x_range).map(|(a, b)| (a.0.min(b.0), a.1.max(b.1)));
            one.series.extend(two.series);
            Some(one)
        });
        Self { panels: panels.collect(), ..Self::new(format!("{name} and {other_name}")) }
    }
}

impl Panel {
    /// From x = 0 on, with a name behind every label.
    fn named(mut self, name: &str) -> Self {
        let begin = self.x_range.map_or(0.0, |range| range.0);
        self.x_range = self.x_range.map(|range| (0.0, range.1 - begin));
        for Series { label, shape } in &mut self.series {
            *label = format!("{label}, {name}");
            match shape {
                Shape::Line(points) | Shape::Dashed(points) | Shape::Points(points) => {
                    points.iter_mut().for_each(|point| point.0 -= begin);
                }
                Shape::Band(points) => points.iter_mut().for_each(|point| point.0 -= begin),
                Shape::Marks(at) => at.iter_mut().for_each(|x| *x -= begin),
            }
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_begin_at_zero_and_keep_their_names() {
        let run = |begin: f64, end: f64| {
            let line = [(begin, 1.0), (end, 2.0)];
            let speed = Panel::new("time (s)", "speed (rpm)").line("speed", &line).x_range(begin, end);
            Figure::new("").panel(speed)
        };
        let longer = run(5.0, 9.0).panel(Panel::new("time (s)", "error (°)"));
        let both = run(1.0, 3.0).over("a", longer, "b");
        let [panel] = both.panels.as_slice() else { panic!("{both:?}") };
        assert_eq!(panel.x_range, Some((0.0, 4.0)));
        let labels: Vec<&str> = panel.series.iter().map(|series| &*series.label).collect();
        assert_eq!(labels, ["speed, a", "speed, b"]);
        assert!(
            panel
                .series
                .iter()
                .all(|series| matches!(&series.shape, Shape::Line(points) if points[0] == (0.0, points[0].1)))
        );
    }
}
