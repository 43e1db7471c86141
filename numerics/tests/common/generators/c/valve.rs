//! The control valve: a stem with mass, driven by air against a spring, held by friction.
//!
//! All forces are divided by the spring's stiffness, so that a force is a travel in %.
//! Band on reversal and slip jump follow from the forces: S = hold + slide, J = hold − slide.

/// Steps of a stem that moves, per substep of the process.
const STEM_STEPS: usize = 8;
/// Steps of a stem with next to no friction, per substep of the process.
const SOUND_STEPS: usize = 2;
/// Static friction below which a valve is taken as sound (%).
const SOUND: f64 = 0.05;
/// Below this share of static friction the bristles only bend, and one step per substep will do.
const BENDS: f64 = 0.8;
/// Stiffness of the bristles (LuGre) by that of the spring, or of spring and positioner together.
const BRISTLE: f64 = 500.0;
/// Damping of the bristles' own oscillation, as a damping ratio.
const BRISTLE_DAMPING: f64 = 0.4;
/// Most passes of the search for the speed at the end of a step (LuGre).
const PASSES: usize = 6;
/// Stribeck speed by the speed that a slip reaches.
const STRIBECK: f64 = 0.002;
/// Below this share of the Stribeck speed a stem counts as standing (Karnopp).
const STANDSTILL: f64 = 0.2;

/// Friction of one direction of travel (%).
#[derive(Clone, Copy, Debug)]
pub struct Force {
    /// Static friction.
    pub hold: f64,
    /// Coulomb friction.
    pub slide: f64,
}

impl Force {
    /// The forces that give the band S and the jump J, both in %.
    pub fn from_band(s: f64, j: f64) -> Self {
        Self { hold: 0.5 * (s + j), slide: 0.5 * (s - j) }
    }

    /// Both forces multiplied.
    pub fn times(self, factor: f64) -> Self {
        Self { hold: self.hold * factor, slide: self.slide * factor }
    }
}

/// How friction is modelled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Model {
    /// Standing and sliding as two states, with a Stribeck curve between them.
    Karnopp,
    /// Bristles that bend and slip.
    Lugre,
}

/// What a valve is made of.
#[derive(Clone, Debug)]
pub struct Valve {
    /// How friction is modelled.
    pub model: Model,
    /// Friction while opening.
    pub opening: Force,
    /// Friction while closing.
    pub closing: Force,
    /// Period of the stem on its spring over 2π (s).
    pub stem: f64,
    /// Damping ratio of the stem by viscous friction.
    pub damping: f64,
    /// Lag of filling the actuator with air (s).
    pub air: f64,
    /// Gain of a positioner; 0 without one.
    pub positioner: f64,
    /// Mechanical stops (% of travel).
    pub stops: (f64, f64),
}

/// A valve in motion.
#[derive(Clone, Debug)]
pub struct Stem {
    valve: Valve,
    opening: Force,
    closing: Force,
    stribeck: f64,
    /// Factor on all friction.
    scale: f64,
    /// Position (%).
    pub x: f64,
    v: f64,
    air: f64,
    bristle: f64,
}

impl Stem {
    /// A valve at rest at `x`, free of tension.
    pub fn new(valve: &Valve, x: f64) -> Self {
        // A positioner multiplies the force on the stem, and with it what friction is worth in % of travel.
        let stiff = 1.0 + valve.positioner;
        let (opening, closing) = (valve.opening.times(stiff), valve.closing.times(stiff));
        let hold = 0.5 * (opening.hold + closing.hold);
        let drop = hold - 0.5 * (opening.slide + closing.slide);
        let stribeck = STRIBECK * drop.max(0.05 * hold) / stiff.sqrt() / valve.stem;
        Self { valve: valve.clone(), opening, closing, stribeck, scale: 1.0, x, v: 0.0, air: x, bristle: 0.0 }
    }

    /// Multiplies all friction from now on.
    pub fn set_friction(&mut self, scale: f64) {
        self.scale = scale;
    }

    /// Moves for `h` seconds under the signal `u` (%).
    pub fn step(&mut self, u: f64, h: f64) {
        let steps = self.steps(u);
        let dt = h / steps as f64;
        let fill = 1.0 - (-dt / self.valve.air).exp();
        for _ in 0..steps {
            let target = u + self.valve.positioner * (u - self.x);
            self.air += fill * (target - self.air);
            match self.valve.model {
                Model::Karnopp => self.karnopp(dt),
                Model::Lugre => self.lugre(dt),
            }
            self.meet_stops();
        }
    }

    /// Steps that the next substep needs: many where the stem moves or is about to.
    fn steps(&self, u: f64) -> usize {
        let least = 0.5 * (self.opening.hold + self.closing.hold);
        if least < SOUND {
            return SOUND_STEPS;
        }
        // The air lies between where it is and where it goes to.
        let target = u + self.valve.positioner * (u - self.x);
        let pull = (target - self.x).max(self.air - self.x);
        let push = (self.x - target).max(self.x - self.air);
        let bends = pull < BENDS * self.force(1.0).hold && push < BENDS * self.force(-1.0).hold;
        if bends && self.v.abs() < self.stribeck { 1 } else { STEM_STEPS }
    }

    /// Moves for `h` seconds as if there were no friction and no mass.
    pub fn step_free(&mut self, u: f64, h: f64) {
        let air = self.valve.air / (1.0 + self.valve.positioner);
        self.air += (1.0 - (-h / air).exp()) * (u - self.air);
        self.x = self.air.clamp(self.valve.stops.0, self.valve.stops.1);
    }

    fn meet_stops(&mut self) {
        let (low, high) = self.valve.stops;
        if self.x < low || self.x > high {
            self.x = self.x.clamp(low, high);
            self.v = 0.0;
        }
    }

    /// Friction in the direction of `way`.
    fn force(&self, way: f64) -> Force {
        if way < 0.0 { self.closing.times(self.scale) } else { self.opening.times(self.scale) }
    }

    /// Friction at the speed `v`: static friction at rest falls to Coulomb friction (Stribeck).
    fn friction(&self, force: Force, v: f64) -> f64 {
        let ratio = v / self.stribeck;
        if ratio.abs() > 4.0 {
            return force.slide;
        }
        force.slide + (force.hold - force.slide) * (-ratio * ratio).exp()
    }

    fn karnopp(&mut self, dt: f64) {
        let pull = self.air - self.x;
        let way = if self.v == 0.0 { pull.signum() } else { self.v.signum() };
        let force = self.force(way);
        let held = pull * way <= force.hold;
        if self.v == 0.0 && held {
            return;
        }
        let mass = self.valve.stem * self.valve.stem;
        let viscous = 2.0 * self.valve.damping * self.valve.stem;
        let friction = way * self.friction(force, self.v);
        let v = (mass * self.v + dt * (pull - friction)) / (mass + dt * (viscous + dt));
        let slow = v.abs() < STANDSTILL * self.stribeck && held;
        self.v = if v * way <= 0.0 || slow { 0.0 } else { v };
        self.x += dt * self.v;
    }

    fn lugre(&mut self, dt: f64) {
        let mass = self.valve.stem * self.valve.stem;
        let viscous = 2.0 * self.valve.damping * self.valve.stem;
        let stiffness = BRISTLE * (1.0 + self.valve.positioner);
        // Bristles that slip do not damp, as usual for this model: else they would push the stem on at a slip.
        let slipping = (self.v / self.stribeck).powi(2);
        let damping = 2.0 * BRISTLE_DAMPING * stiffness.sqrt() * self.valve.stem / (1.0 + slipping);
        let inner = stiffness + damping / dt;
        let mut v = self.v;
        let mut level = self.level(v);
        // The speed is found implicitly; the bristles' slipping takes it from the pass before.
        for _ in 0..PASSES {
            let keep = 1.0 / (1.0 + dt * stiffness * v.abs() / level);
            let drive = mass / dt * self.v + self.air - self.x;
            let bristle = inner * keep * self.bristle - damping * self.bristle / dt;
            let before = v;
            v = (drive - bristle) / (mass / dt + dt + viscous + inner * keep * dt);
            level = self.level(v);
            if (v - before).abs() < 0.1 * self.stribeck + 1e-3 * v.abs() {
                break;
            }
        }
        let most = level / stiffness;
        let bristle = (self.bristle + dt * v) / (1.0 + dt * v.abs() / most);
        self.bristle = bristle.clamp(-most, most);
        self.v = v;
        self.x += dt * v;
    }

    /// Friction that the bristles can carry at the speed `v`.
    fn level(&self, v: f64) -> f64 {
        let way = if v == 0.0 { self.bristle } else { v };
        self.friction(self.force(way), v).max(1e-6)
    }
}
