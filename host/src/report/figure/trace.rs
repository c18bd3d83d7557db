//! From points in pixels to what is worth drawing: gaps, thinning to the pixel column, clipping, dashes.

/// A point in pixels.
pub(super) type Pixel = (f64, f64);

/// A rectangle in pixels.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frame {
    pub(super) left: f64,
    pub(super) top: f64,
    pub(super) right: f64,
    pub(super) bottom: f64,
}

/// Splits at points that are not finite.
pub(super) fn stretches<T: Copy>(points: impl Iterator<Item = T>, finite: impl Fn(&T) -> bool) -> Vec<Vec<T>> {
    let mut all = vec![Vec::new()];
    for point in points {
        if finite(&point) {
            all.last_mut().expect("starts with one stretch").push(point);
        } else if all.last().is_some_and(|s| !s.is_empty()) {
            all.push(Vec::new());
        }
    }
    all.retain(|s| !s.is_empty());
    all
}

/// Keeps first, lowest, highest and last of each run of points in one pixel column: the picture stays the same, whatever
/// the number of points.
pub(super) fn thin(points: &[Pixel]) -> Vec<Pixel> {
    let mut kept = Vec::new();
    for column in points.chunk_by(|a, b| a.0.floor() == b.0.floor()) {
        if column.len() <= 4 {
            kept.extend_from_slice(column);
            continue;
        }
        let last = column.len() - 1;
        let (mut low, mut high) = (0, 0);
        for (i, p) in column.iter().enumerate() {
            if p.1 < column[low].1 {
                low = i;
            }
            if p.1 > column[high].1 {
                high = i;
            }
        }
        let mut order = [0, low.min(high), low.max(high), last].to_vec();
        order.dedup();
        kept.extend(order.into_iter().map(|i| column[i]));
    }
    kept
}

/// The parts of the polyline inside `frame`.
pub(super) fn clip(points: &[Pixel], frame: Frame) -> Vec<Vec<Pixel>> {
    let mut parts: Vec<Vec<Pixel>> = Vec::new();
    for pair in points.windows(2) {
        let Some((a, b)) = clip_segment(pair[0], pair[1], frame) else { continue };
        match parts.last_mut() {
            Some(part) if part.last() == Some(&a) => part.push(b),
            _ => parts.push(vec![a, b]),
        }
    }
    parts
}

/// Liang and Barsky's clipping of one segment.
fn clip_segment(a: Pixel, b: Pixel, frame: Frame) -> Option<(Pixel, Pixel)> {
    let (dx, dy) = (b.0 - a.0, b.1 - a.1);
    let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
    for (p, q) in [(-dx, a.0 - frame.left), (dx, frame.right - a.0), (-dy, a.1 - frame.top), (dy, frame.bottom - a.1)] {
        if p == 0.0 {
            if q < 0.0 {
                return None;
            }
        } else if p < 0.0 {
            enter = enter.max(q / p);
        } else {
            leave = leave.min(q / p);
        }
    }
    let at = |t: f64| {
        if t == 0.0 {
            a
        } else if t == 1.0 {
            b
        } else {
            (a.0 + t * dx, a.1 + t * dy)
        }
    };
    (enter <= leave).then(|| (at(enter), at(leave)))
}

/// Cuts a polyline into dashes of length `on` with gaps of length `off`.
pub(super) fn dashes(points: &[Pixel], on: f64, off: f64) -> Vec<Vec<Pixel>> {
    let mut parts: Vec<Vec<Pixel>> = points.first().map(|p| vec![vec![*p]]).unwrap_or_default();
    let (mut drawing, mut left) = (true, on);
    for pair in points.windows(2) {
        let (mut from, to) = (pair[0], pair[1]);
        loop {
            let length = (to.0 - from.0).hypot(to.1 - from.1);
            if length < left {
                left -= length;
                if drawing && let Some(part) = parts.last_mut() {
                    part.push(to);
                }
                break;
            }
            from = (from.0 + (to.0 - from.0) * left / length, from.1 + (to.1 - from.1) * left / length);
            if drawing {
                if let Some(part) = parts.last_mut() {
                    part.push(from);
                }
            } else {
                parts.push(vec![from]);
            }
            drawing = !drawing;
            left = if drawing { on } else { off };
        }
    }
    parts.retain(|p| p.len() > 1);
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: Frame = Frame { left: 0.0, top: 0.0, right: 10.0, bottom: 10.0 };

    #[test]
    fn clipping_cuts_at_the_frame() {
        let parts = clip(&[(-5.0, 5.0), (5.0, 5.0), (5.0, 25.0), (8.0, 5.0)], FRAME);
        assert_eq!(parts.len(), 2);
        assert_eq!(parts[0], [(0.0, 5.0), (5.0, 5.0), (5.0, 10.0)]);
        assert_eq!(parts[1], [(7.25, 10.0), (8.0, 5.0)].map(|(x, y)| (x - 0.0, y)));
        assert!(clip(&[(-1.0, -1.0), (-1.0, 11.0)], FRAME).is_empty());
    }

    #[test]
    fn thinning_keeps_the_extremes_of_each_column() {
        let points: Vec<Pixel> =
            (0..1000).map(|i| (i as f64 / 100.0, if i == 537 { 99.0 } else { (i % 7) as f64 })).collect();
        let kept = thin(&points);
        assert!(kept.len() <= 40);
        assert!(kept.contains(&(5.37, 99.0)));
        assert!(kept.is_sorted_by(|a, b| a.0 <= b.0));
    }

    #[test]
    fn dashes_cover_their_share() {
        let parts = dashes(&[(0.0, 0.0), (98.0, 0.0)], 6.0, 4.0);
        let drawn: f64 = parts.iter().map(|p| p.last().unwrap().0 - p[0].0).sum();
        assert!((drawn - 60.0).abs() < 1e-9);
        assert_eq!(parts.len(), 10);
    }
}
