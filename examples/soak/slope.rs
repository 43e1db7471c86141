//! How fast something grows, and how sure that is: a straight line through medians, over what recurs.

use std::fmt;

/// Parts of a round. Each is one number, its median: looks that follow each other closely say the same again, and would make
/// the interval far too narrow.
const PARTS: usize = 3;
/// The upper 2.5 % of Student's distribution, for 1, 2, … degrees of freedom.
const STUDENT: [f64; 12] =
    [12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179];

/// Growth in an hour, and half of its 95 % interval; that is infinite where there is too little to tell.
#[derive(Clone, Copy, Debug)]
pub struct Slope {
    pub per_hour: f64,
    pub half_width: f64,
}

/// What a slope says of a bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Judged {
    Holds,
    Broken,
    /// There is no degree of freedom, so the interval has no end and nothing is known.
    TooShort,
}

impl fmt::Display for Judged {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Judged::Holds => "holds",
            Judged::Broken => "BROKEN",
            Judged::TooShort => "NOT JUDGED, the run was too short",
        })
    }
}

impl Slope {
    /// Of points (s, …) on which something recurs after each `round` (s). Each part of a round has a level of its own: only
    /// parts at the same place of two rounds are compared, so that what comes and goes in every round is no slope. What is left
    /// of two parts counts as independent.
    pub fn of(points: &[(f64, f64)], round: f64) -> Self {
        let parts = medians(points, round / PARTS as f64);
        let (mut over, mut under, mut places, mut rest) = (0.0, 0.0, 0, Vec::new());
        for place in 0..PARTS {
            let alike: Vec<(f64, f64)> =
                parts.iter().filter(|part| part.0 % PARTS == place).map(|part| part.1).collect();
            let n = alike.len() as f64;
            places += usize::from(!alike.is_empty());
            let (x, y) = alike.iter().fold((0.0, 0.0), |(x, y), part| (x + part.0 / n, y + part.1 / n));
            for part in &alike {
                over += (part.0 - x) * (part.1 - y);
                under += (part.0 - x).powi(2);
                rest.push((part.0 - x, part.1 - y));
            }
        }
        let slope = over / under;
        let freedom = parts.len().saturating_sub(places + 1);
        let square: f64 = rest.iter().map(|(x, y)| (y - slope * x).powi(2)).sum();
        let deviation = (square / freedom as f64 / under).sqrt();
        let half_width = if freedom == 0 { f64::INFINITY } else { student(freedom) * deviation };
        Self { per_hour: 3600.0 * slope, half_width: 3600.0 * half_width }
    }

    /// Whether the lower end of the interval is at most `most` (an hour).
    pub fn judged(self, most: f64) -> Judged {
        match self.interval()[0] {
            low if !low.is_finite() => Judged::TooShort,
            low if low <= most => Judged::Holds,
            _ => Judged::Broken,
        }
    }

    /// What that means, in words: a bound that holds is not proven to, while the interval goes beyond it.
    pub fn meaning(self, most: f64, unit: &str) -> String {
        let [low, high] = self.interval();
        match self.judged(most) {
            Judged::TooShort => "nothing is known of the growth".to_string(),
            Judged::Broken => {
                format!("a growth above {most} {unit} is proven at 95 %: it is {low:.2} {unit} or more")
            }
            Judged::Holds if high <= most => format!("a growth above {most} {unit} is ruled out at 95 %"),
            Judged::Holds => {
                format!(
                    "a growth above {most} {unit} is not proven, and one of up to {high:.2} {unit} is not ruled out"
                )
            }
        }
    }

    /// Ends of the 95 % interval.
    pub fn interval(self) -> [f64; 2] {
        [self.per_hour - self.half_width, self.per_hour + self.half_width]
    }
}

/// The middle one; NaN of none.
pub fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Parts of `length` (s) by number, each with the medians of its times and values. One of which less than half is there, as at
/// an end, is left out.
fn medians(points: &[(f64, f64)], length: f64) -> Vec<(usize, (f64, f64))> {
    let number = |point: &(f64, f64)| (point.0 / length) as usize;
    let parts: Vec<&[(f64, f64)]> = points.chunk_by(|a, b| number(a) == number(b)).collect();
    let whole = parts.iter().map(|part| part.len()).max().unwrap_or(0);
    let parts = parts.into_iter().filter(|part| 2 * part.len() >= whole);
    let of = |part: &[(f64, f64)]| {
        let at = |of: fn(&(f64, f64)) -> f64| median(part.iter().map(of));
        (number(&part[0]), (at(|point| point.0), at(|point| point.1)))
    };
    parts.map(of).collect()
}

/// The upper 2.5 % of Student's distribution.
fn student(freedom: usize) -> f64 {
    let n = freedom as f64;
    STUDENT.get(freedom.saturating_sub(1)).copied().unwrap_or(1.960 + 2.372 / n + 2.823 / (n * n))
}
