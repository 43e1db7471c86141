//! Controllers: PI and PID, positional or by velocity, in series or standard form; times in samples.

/// Limits of OP (%).
const LIMITS: (f64, f64) = (0.0, 100.0);

/// Settings of a controller.
#[derive(Clone, Debug)]
pub struct Tuning {
    /// Gain with the sign of the action (% of OP by PV).
    pub gain: f64,
    /// Reset time (samples).
    pub reset: f64,
    /// Derivative time (samples); 0 for PI.
    pub rate: f64,
    /// Derivative time by the time of its filter.
    pub filter: f64,
    /// Weight of the set point in the proportional part.
    pub weight: f64,
    /// True for the velocity form, false for the positional one.
    pub velocity: bool,
    /// True for the series (interacting) form.
    pub series: bool,
}

impl Tuning {
    /// The form in a few words.
    pub fn name(&self) -> String {
        let kind = if self.rate > 0.0 { "PID" } else { "PI" };
        let structure = if self.series && self.rate > 0.0 { " series" } else { "" };
        let form = if self.velocity { "velocity" } else { "positional" };
        format!("{kind}{structure} {form}")
    }
}

/// A controller at work.
pub struct Controller<'a> {
    tuning: &'a Tuning,
    /// Integral part, or the output itself in the velocity form.
    sum: f64,
    filtered: f64,
    proportional: f64,
    derivative: f64,
}

impl<'a> Controller<'a> {
    /// A controller that starts bumpless from the output `op` at PV `pv`.
    pub fn new(tuning: &'a Tuning, op: f64, pv: f64) -> Self {
        let proportional = tuning.gain * (tuning.weight - 1.0) * pv;
        let sum = if tuning.velocity { op } else { op - proportional };
        Self { tuning, sum, filtered: pv, proportional, derivative: 0.0 }
    }

    /// One scan: the new output.
    pub fn scan(&mut self, sp: f64, pv: f64) -> f64 {
        let t = self.tuning;
        let (measured, derivative) = self.derive(pv);
        let proportional = t.gain * (t.weight * sp - measured);
        let integral = t.gain / t.reset * (sp - measured);
        let op = if t.velocity {
            self.sum += proportional - self.proportional + integral + derivative - self.derivative;
            self.sum = self.sum.clamp(LIMITS.0, LIMITS.1);
            self.sum
        } else {
            self.sum += integral;
            let raw = proportional + self.sum + derivative;
            let op = raw.clamp(LIMITS.0, LIMITS.1);
            self.sum += op - raw;
            op
        };
        (self.proportional, self.derivative) = (proportional, derivative);
        op
    }

    /// What the proportional part sees of PV, and the derivative part.
    fn derive(&mut self, pv: f64) -> (f64, f64) {
        let t = self.tuning;
        if t.rate <= 0.0 {
            return (pv, 0.0);
        }
        let share = 1.0 / (1.0 + t.rate / t.filter);
        let before = self.filtered;
        self.filtered += share * (pv - before);
        let lead = t.rate * (self.filtered - before);
        if t.series { (self.filtered + lead, 0.0) } else { (pv, -t.gain * lead) }
    }
}
