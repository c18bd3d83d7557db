//! A line thinned while it is read.

/// A line is thinned to this many columns before it is drawn: more than any picture shows.
const COLUMNS: f64 = 8_000.0;

/// First, lowest, highest and last value of each column of equal width, so that memory does not grow with the record.
pub(super) struct Trace {
    column_s: f64,
    column: i64,
    points: Vec<(f64, f64)>,
    /// First, lowest, highest, last.
    current: Option<[(f64, f64); 4]>,
}

impl Trace {
    /// A trace of a record `span_s` long.
    pub fn new(span_s: f64) -> Self {
        Self { column_s: (span_s / COLUMNS).max(1e-9), column: 0, points: Vec::new(), current: None }
    }

    pub fn push(&mut self, time_s: f64, value: f64) {
        let point = (time_s, value);
        let column = (time_s / self.column_s).floor() as i64;
        match &mut self.current {
            Some([_, low, high, last]) if column == self.column => {
                *last = point;
                if value < low.1 {
                    *low = point;
                }
                if value > high.1 {
                    *high = point;
                }
            }
            _ => {
                self.flush();
                self.column = column;
                self.current = Some([point; 4]);
            }
        }
    }

    /// Breaks the line.
    pub fn gap(&mut self) {
        self.flush();
        if self.points.last().is_some_and(|point| point.1.is_finite()) {
            self.points.push((f64::NAN, f64::NAN));
        }
    }

    fn flush(&mut self) {
        if let Some([first, low, high, last]) = self.current.take() {
            let (early, late) = if low.0 <= high.0 { (low, high) } else { (high, low) };
            self.points.extend([first, early, late, last]);
            self.points.dedup();
        }
    }

    pub fn done(mut self) -> Vec<(f64, f64)> {
        self.flush();
        self.points
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trace_keeps_extremes_and_gaps_and_forgets_the_rest() {
        let mut trace = Trace::new(100.0);
        for index in 0..1_000_000 {
            let time_s = f64::from(index) * 1e-4;
            trace.push(time_s, if index == 512_345 { 9.0 } else { time_s.sin() });
            if index == 700_000 {
                trace.gap();
            }
        }
        let points = trace.done();
        assert!(points.len() < 4 * 8_001 + 10, "{}", points.len());
        assert_eq!(points.iter().filter(|point| point.1 == 9.0).count(), 1);
        assert_eq!(points.iter().filter(|point| point.1.is_nan()).count(), 1);
    }
}
