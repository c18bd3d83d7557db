//! The averaged model's state of one moment: the complex amplitudes of the waves, and how the rotor moves.

/// A complex number; `num-complex` would be a dependency for four operations.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Complex {
    pub(super) re: f64,
    pub(super) im: f64,
}

impl Complex {
    pub(super) const ZERO: Complex = Complex { re: 0.0, im: 0.0 };

    #[inline]
    pub(super) fn new(re: f64, im: f64) -> Self {
        Complex { re, im }
    }

    #[inline]
    pub(super) fn times(self, o: Complex) -> Complex {
        Complex::new(self.re * o.re - self.im * o.im, self.re * o.im + self.im * o.re)
    }

    #[inline]
    pub(super) fn scaled(self, k: f64) -> Complex {
        Complex::new(self.re * k, self.im * k)
    }

    #[inline]
    pub(super) fn plus(self, o: Complex) -> Complex {
        Complex::new(self.re + o.re, self.im + o.im)
    }

    #[inline]
    pub(super) fn minus(self, o: Complex) -> Complex {
        Complex::new(self.re - o.re, self.im - o.im)
    }

    #[inline]
    pub(super) fn square(self) -> f64 {
        self.re * self.re + self.im * self.im
    }

    #[inline]
    pub(super) fn inverse(self) -> Complex {
        let k = 1.0 / self.square();
        Complex::new(self.re * k, -self.im * k)
    }

    #[inline]
    pub(super) fn exp(self) -> Complex {
        let (sin, cos) = self.im.sin_cos();
        let e = self.re.exp();
        Complex::new(e * cos, e * sin)
    }
}

/// What decides how the rotor moves on, its angle aside.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Momentary {
    pub(super) waves: [Complex; 2],
    pub(super) speed_rad_s: f64,
    pub(super) turning: f64,
    pub(super) bristle_rad: f64,
}

impl Momentary {
    /// No wave, no motion.
    pub(super) const REST: Momentary =
        Momentary { waves: [Complex::ZERO; 2], speed_rad_s: 0.0, turning: 0.0, bristle_rad: 0.0 };

    /// What two states are the same by.
    pub(super) fn bits(&self) -> [u64; 7] {
        let [cw, ccw] = self.waves;
        [cw.re, cw.im, ccw.re, ccw.im, self.speed_rad_s, self.turning, self.bristle_rad].map(f64::to_bits)
    }

    pub(super) fn speed_rad_s(&self) -> f64 {
        self.speed_rad_s
    }

    pub(super) fn at_rest(&self) -> bool {
        *self == Momentary::REST
    }

    /// Weighted mean; the weights sum to 1.
    pub(super) fn mean(parts: impl Iterator<Item = (Momentary, f64)>) -> Momentary {
        parts.fold(Momentary::REST, |sum, (part, weight)| Momentary {
            waves: [0, 1].map(|i| sum.waves[i].plus(part.waves[i].scaled(weight))),
            speed_rad_s: sum.speed_rad_s + weight * part.speed_rad_s,
            turning: sum.turning + weight * part.turning,
            bristle_rad: sum.bristle_rad + weight * part.bristle_rad,
        })
    }
}
