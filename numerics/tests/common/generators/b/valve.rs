//! Valves that stick, as recursions on OP at the controller's scan.
//!
//! All four models follow from one static and one kinetic friction, given as OP: Fs and Fc.
//! After a slip the stem rests at OP - Fc (opening).
//! It moves on when OP - stem passes Fs, and back when it passes -Fs.
//! So the band on a reversal is S = Fs + Fc and the slip at breakaway is J = Fs - Fc.
//!
//! - Kano: S and J directly; the stem keeps moving with OP until OP rests or turns.
//! - Stenman: one parameter d, and the stem jumps onto OP: Fs = d, Fc = 0, so that S = J = d.
//! - He (2007): fs and fd are Fs and Fc; the stem is at rest again after each scan.
//! - Karnopp: Fs and Fc; the stem slips on while OP moves faster than the stop speed.

/// Which recursion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Model {
    /// Kano's logic of moving and resting states.
    Kano,
    /// Stenman's jump with one parameter.
    Stenman,
    /// He's residual force of 2007.
    He,
    /// Karnopp's zero-velocity interval, without mass and spring.
    Karnopp,
}

/// Friction of a valve (% of OP's span).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Friction {
    /// Which recursion.
    pub model: Model,
    /// Mean of the bands S towards opening and towards closing.
    pub s: f64,
    /// Mean of the slips J towards opening and towards closing.
    pub j: f64,
    /// Band towards opening over band towards closing.
    pub ratio: f64,
}

impl Friction {
    /// Kinetic friction Fc, the same both ways.
    fn kinetic(&self) -> f64 {
        (self.s - self.j) / 2.0
    }

    /// Band S towards opening (`way` > 0) or closing.
    pub fn band(&self, way: f64) -> f64 {
        let share = if way > 0.0 { self.ratio } else { 1.0 };
        2.0 * self.s * share / (1.0 + self.ratio)
    }

    /// Static friction Fs towards opening or closing.
    fn breakaway(&self, way: f64) -> f64 {
        self.band(way) - self.kinetic()
    }

    /// Slip J towards opening or closing: the dead band S - J is one for both ways, so the slip differs as S does.
    pub fn slip(&self, way: f64) -> f64 {
        self.band(way) - 2.0 * self.kinetic()
    }
}

/// Karnopp's stop speed as a share of S, per scan.
const STOP_SPEED: f64 = 0.05;

/// A valve in operation (positions in % of OP's span).
#[derive(Clone, Debug)]
pub struct Valve {
    friction: Option<Friction>,
    /// Mechanical stops of the stem.
    stops: (f64, f64),
    stem: f64,
    op: f64,
    /// Last change of OP.
    change: f64,
    /// Direction of the last motion.
    way: f64,
    moving: bool,
    /// OP at which the stem came to rest (Kano).
    rested: f64,
}

impl Valve {
    /// A valve at rest where OP is; `None` for a sound one that follows OP exactly.
    pub fn new(friction: Option<Friction>, stops: (f64, f64), op: f64) -> Self {
        let rested = op + friction.map_or(0.0, |f| f.kinetic());
        Self { friction, stops, stem: op, op, change: 0.0, way: 1.0, moving: false, rested }
    }

    /// The stem after OP's next value; `worn` multiplies the friction.
    pub fn step(&mut self, op: f64, worn: f64) -> f64 {
        match self.friction {
            None => self.stem = op,
            Some(f) => {
                let f = Friction { s: f.s * worn, j: f.j * worn, ..f };
                match f.model {
                    Model::Kano => self.kano(&f, op),
                    Model::Stenman | Model::He => self.residual_force(&f, op),
                    Model::Karnopp => self.karnopp(&f, op),
                }
            }
        }
        self.change = op - self.op;
        self.op = op;
        self.hit_stop();
        self.stem
    }

    /// Holds the stem at a stop, where it then rests.
    fn hit_stop(&mut self) {
        let held = self.stem.clamp(self.stops.0, self.stops.1);
        if held != self.stem {
            self.stem = held;
            self.moving = false;
            self.rested = held + self.way * self.friction.map_or(0.0, |f| f.kinetic());
        }
    }

    /// Kano: rests when OP stops or turns, and moves again J further on or S back.
    fn kano(&mut self, f: &Friction, op: f64) {
        let change = op - self.op;
        if self.moving && change * self.way <= 0.0 {
            self.moving = false;
            self.rested = self.op;
        }
        if !self.moving {
            let on = self.way * (op - self.rested);
            if on > f.slip(self.way) && change * self.way > 0.0 {
                self.moving = true;
            } else if -on > f.band(-self.way) {
                self.moving = true;
                self.way = -self.way;
            }
        }
        if self.moving {
            self.slide(f, op);
        }
    }

    /// He: the force that friction holds grows with OP, and a slip leaves Fc of it. Stenman: the same with Fc = 0.
    fn residual_force(&mut self, f: &Friction, op: f64) {
        let force = op - self.stem;
        if force > f.breakaway(1.0) || -force > f.breakaway(-1.0) {
            self.way = force.signum();
            self.slide(f, op);
        }
    }

    /// Karnopp: slips against Fc while OP moves on faster than the stop speed, and breaks away at Fs otherwise.
    fn karnopp(&mut self, f: &Friction, op: f64) {
        self.moving = self.moving && self.way * (op - self.op) > STOP_SPEED * f.s;
        if self.moving {
            self.slide(f, op);
            return;
        }
        let stem = self.stem;
        self.residual_force(f, op);
        self.moving = stem != self.stem;
    }

    /// Takes the stem to the balance with kinetic friction, never backwards.
    fn slide(&mut self, f: &Friction, op: f64) {
        let balance = op - self.way * f.kinetic();
        if self.way * (balance - self.stem) > 0.0 {
            self.stem = balance;
        }
    }
}
