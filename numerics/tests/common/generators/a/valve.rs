//! Sticking valves with bands and lags of their own for each direction, which the project's simulator does not have.

/// How the stem follows OP.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// Choudhury's (Kano's told by forces moves alike): sticks at every stop, resumes after J, trails by (S - J)/2.
    Choudhury,
    /// He's: each slip leaves the force fd.
    He,
    /// The one-parameter element: sticks at reversals only, follows without lag.
    OneParameter,
}

/// |change of OP| up to this counts as stopped (% OP).
const RESOLUTION: f64 = 0.005;

/// A valve at work.
pub struct Valve {
    kind: Kind,
    mv: f64,
    held: f64,
    dir: f64,
    moving: bool,
    op: f64,
}

impl Valve {
    /// At rest at `op`, with about the same force needed to move it either way.
    pub fn new(kind: Kind, op: f64, s: f64, j: f64) -> Self {
        let held = if kind == Kind::He { 0.0 } else { op + 0.5 * (s - j) };
        Self { kind, mv: op, held, dir: 1.0, moving: false, op }
    }

    /// The stem for this OP; `s` for opening and closing.
    pub fn step(&mut self, op: f64, s: [f64; 2], j: f64) -> f64 {
        let mean = 0.5 * (s[0] + s[1]);
        if mean <= 0.0 {
            self.mv = op;
            return op;
        }
        match self.kind {
            Kind::He => {
                let force = self.held + op - self.op;
                let fd = 0.5 * (mean - j);
                // fs + fd is the band S of each direction.
                let fs = if force > 0.0 { s[0] - fd } else { s[1] - fd }.max(fd);
                self.held = force;
                if force.abs() > fs {
                    self.mv += force - force.signum() * fd;
                    self.held = force.signum() * fd;
                }
            }
            Kind::Choudhury | Kind::OneParameter => {
                let sticks_at_stops = self.kind == Kind::Choudhury;
                let along = (op - self.op) * self.dir;
                if self.moving && (if sticks_at_stops { along <= RESOLUTION } else { along < 0.0 }) {
                    self.moving = false;
                    self.held = self.op;
                }
                if !self.moving {
                    let ahead = (op - self.held) * self.dir;
                    // Turning to the direction opposite to the last takes that direction's band.
                    let band = if self.dir > 0.0 { s[1] } else { s[0] };
                    if -ahead > band {
                        self.dir = -self.dir;
                        self.moving = true;
                    } else if ahead > if sticks_at_stops { j } else { 0.0 } {
                        self.moving = true;
                    }
                }
                if self.moving {
                    let lag = if sticks_at_stops { 0.5 * (mean - j).max(0.0) } else { 0.0 };
                    self.mv = op - self.dir * lag;
                }
            }
        }
        self.op = op;
        self.mv
    }
}
