//! The opinion of one method on a valve: its answer, its index and thresholds, and its reason.

use crate::signal::{beside, share_beside};

/// A method of the literature.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Method {
    /// The loop of OP and the measured stem: the reference for all others.
    StemLoop,
    /// Cross-correlation.
    Horch1999,
    /// Distribution of the second derivative.
    Horch2000,
    /// Qualitative shapes.
    Yamashita2006,
    /// Time in which PV stands still while OP moves.
    Kano2004A,
    /// Parallelogram of OP and PV.
    Kano2004B,
    /// Curve fit, stiction index.
    He2007,
    /// Bicoherence, apparent stiction.
    Choudhury2006,
    /// Shapes by dynamic time warping.
    Srinivasan2005Shape,
    /// Hammerstein model, parameter d.
    Srinivasan2005D,
    /// S and J by a grid of low-order models.
    Lee2008,
    /// Relay fit.
    RossiScali2005,
}

impl Method {
    /// Every method, the reference first.
    pub const ALL: [Method; 12] = [
        Method::StemLoop,
        Method::Horch1999,
        Method::Horch2000,
        Method::Yamashita2006,
        Method::Kano2004A,
        Method::Kano2004B,
        Method::He2007,
        Method::Choudhury2006,
        Method::Srinivasan2005Shape,
        Method::Srinivasan2005D,
        Method::Lee2008,
        Method::RossiScali2005,
    ];

    /// The stable, machine-readable name.
    pub fn as_str(self) -> &'static str {
        match self {
            Method::StemLoop => "stem_loop",
            Method::Horch1999 => "horch_1999",
            Method::Horch2000 => "horch_2000",
            Method::Yamashita2006 => "yamashita_2006",
            Method::Kano2004A => "kano_2004_a",
            Method::Kano2004B => "kano_2004_b",
            Method::He2007 => "he_2007",
            Method::Choudhury2006 => "choudhury_2006",
            Method::Srinivasan2005Shape => "srinivasan_2005_shape",
            Method::Srinivasan2005D => "srinivasan_2005_d",
            Method::Lee2008 => "lee_2008",
            Method::RossiScali2005 => "rossi_scali_2005",
        }
    }

    /// The method that [`Method::as_str`] writes so.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|method| method.as_str() == name)
    }

    /// Its title: author, year, and what it evaluates.
    pub fn title(self) -> &'static str {
        match self {
            Method::StemLoop => "Measured stem against OP",
            Method::Horch1999 => "Horch 1999, cross-correlation",
            Method::Horch2000 => "Horch 2000, second derivative",
            Method::Yamashita2006 => "Yamashita 2006, qualitative shapes",
            Method::Kano2004A => "Kano 2004 A, standstill",
            Method::Kano2004B => "Kano 2004 B, parallelogram",
            Method::He2007 => "He 2007, curve fit",
            Method::Choudhury2006 => "Choudhury 2006, bicoherence",
            Method::Srinivasan2005Shape => "Srinivasan 2005, shapes",
            Method::Srinivasan2005D => "Srinivasan 2005, stick band d",
            Method::Lee2008 => "Lee 2008, grid of S and J",
            Method::RossiScali2005 => "Rossi & Scali 2005, relay fit",
        }
    }
}

/// The answer of a method.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Says {
    /// The valve sticks.
    Sticks,
    /// The valve does not stick: the oscillation has another cause.
    Sound,
    /// The method does not apply here, or its index lies between its thresholds.
    CannotTell,
}

impl Says {
    /// As reports write it.
    pub fn as_str(self) -> &'static str {
        match self {
            Says::Sticks => "sticks",
            Says::Sound => "sound",
            Says::CannotTell => "cannot_tell",
        }
    }
}

/// The thresholds of an index that is larger the more a valve sticks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Band {
    /// Largest index at which a valve is sound (-); minus infinity for an index that never says so.
    pub sound: f64,
    /// Index above which a valve sticks (-). Between the two the method cannot tell.
    pub sticks: f64,
}

impl Band {
    /// One threshold for both answers.
    pub const fn at(threshold: f64) -> Self {
        Self { sound: threshold, sticks: threshold }
    }

    /// A threshold above which a valve sticks, of an index that never says that a valve is sound.
    pub const fn above(sticks: f64) -> Self {
        Self { sound: f64::NEG_INFINITY, sticks }
    }

    /// An index in a sentence: with so many decimals, and with as many more as show on which side of the thresholds it is.
    pub fn told(self, index: f64, decimals: usize) -> String {
        beside(index, &[self.sound, self.sticks], decimals)
    }

    /// [`Band::told`] of an index that is a share: in whole per cent.
    pub fn told_in_percent(self, index: f64) -> String {
        share_beside(index, &[self.sound, self.sticks], 0)
    }

    /// The answer for an index.
    pub fn says(self, index: f64) -> Says {
        if index > self.sticks {
            Says::Sticks
        } else if index <= self.sound {
            Says::Sound
        } else {
            Says::CannotTell
        }
    }
}

/// A quantity that a method measures beside its index.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quantity {
    /// Its value.
    pub value: f64,
    /// Its unit.
    pub unit: &'static str,
    /// What it measures.
    pub measures: &'static str,
}

/// The unit of quantities along OP.
pub const OP_UNIT: &str = "OP unit";

/// The opinion of one method.
#[derive(Clone, Debug, PartialEq)]
pub struct Opinion {
    /// The method.
    pub method: Method,
    /// Its answer.
    pub says: Says,
    /// Its index (-); none where it does not apply.
    pub index: Option<f64>,
    /// The thresholds of the index.
    pub threshold: Option<Band>,
    /// The quantity that it measures.
    pub quantity: Option<Quantity>,
    /// The reason in one line.
    pub why: String,
}

impl Opinion {
    /// An opinion without an answer, with the reason.
    pub fn cannot_tell(method: Method, why: impl Into<String>) -> Self {
        Self { method, says: Says::CannotTell, index: None, threshold: None, quantity: None, why: why.into() }
    }

    /// The opinion for an index; without an answer where the index is not a number.
    pub fn of(method: Method, index: f64, band: Band, why: impl Into<String>) -> Self {
        if !index.is_finite() {
            return Self::cannot_tell(method, "the index is not a number");
        }
        Self {
            method,
            says: band.says(index),
            index: Some(index),
            threshold: Some(band),
            quantity: None,
            why: why.into(),
        }
    }

    /// The same with a measured quantity along OP (OP unit).
    pub fn with(mut self, value: f64, measures: &'static str) -> Self {
        self.quantity = value.is_finite().then_some(Quantity { value, unit: OP_UNIT, measures });
        self
    }

    /// The same without an answer, with another reason.
    pub fn but_cannot_tell(mut self, why: impl Into<String>) -> Self {
        self.says = Says::CannotTell;
        self.why = why.into();
        self
    }
}
