//! `diagnose --plot`: what the model says and what it leaves, before and after the effects, as one picture.

use stictiond::plot::{Panel, Plot, Series, sheet, thin};
use stictiond::residual::Findings;
use stictiond::sysid::spectrum;

/// Points of a curve over time.
const POINTS: usize = 1500;
/// Lags of the correlations (samples).
const LAGS: usize = 50;
/// Bins averaged in a spectrum to each side: a raw periodogram hides its own level.
const SMOOTHED: usize = 2;

/// PV with both models, both residuals over time, their spectra and their autocorrelations.
pub fn picture(name: &str, found: &Findings) -> String {
    let c = &found.curves;
    let kinds: Vec<&str> = found.effects.iter().map(|effect| effect.kind.as_str()).collect();
    let effects = match kinds.len() {
        0 => "no effect added".to_string(),
        1 | 2 => kinds.join(", "),
        // More would not fit the sheet.
        count => format!("{count} effects added"),
    };
    let marks = vec![(c.ts * c.split as f64, "held out")];
    let over_time = |v: &[f64]| -> Vec<(f64, f64)> {
        let points: Vec<(f64, f64)> = v.iter().enumerate().map(|(k, y)| (c.ts * k as f64, *y)).collect();
        thin(&points, POINTS / 2)
    };
    let pv = Plot {
        title: format!("{name}: PV, simulated from OP alone ({effects})"),
        x: "time since the window began (s)",
        panels: vec![panel(
            "PV (unit of PV)",
            [
                ("measured", "pv", over_time(&c.pv)),
                ("before", "sp", over_time(&c.free_before)),
                ("after", "op", over_time(&c.free_after)),
            ],
        )],
        marks: marks.clone(),
    };
    let residual = Plot {
        title: "Residual, one step ahead".into(),
        x: "time since the window began (s)",
        panels: vec![
            panel("before (PV)", [("before", "other", over_time(&c.residual_before))]),
            panel("after (PV)", [("after", "op", over_time(&c.residual_after))]),
        ],
        marks,
    };
    let mut spectra = panel(
        "power (PV² s)",
        [
            ("before", "other", spectrum(&c.residual_before, c.ts)),
            ("after", "op", spectrum(&c.residual_after, c.ts)),
        ],
    );
    spectra.log = true;
    let spectrum = Plot {
        title: "Spectrum of the residual: flat is what a sufficient model leaves".into(),
        x: "frequency (1/s)",
        panels: vec![spectra],
        marks: vec![],
    };
    let bound = 1.96 / (c.residual_after.len().max(1) as f64).sqrt();
    let level = |y: f64| vec![(1.0, y), (LAGS as f64, y)];
    let correlation = Plot {
        title: "Autocorrelation of the residual, with the 95 % band of white noise".into(),
        x: "lag (samples)",
        panels: vec![panel(
            "correlation (-)",
            [
                ("before", "other", autocorrelation(&c.residual_before)),
                ("after", "op", autocorrelation(&c.residual_after)),
                ("95 %", "sp", level(bound)),
                ("", "sp", level(-bound)),
            ],
        )],
        marks: vec![],
    };
    sheet(&[pv, residual, spectrum, correlation])
}

/// Name, colour and points of a curve.
type Curve<'a> = (&'a str, &'static str, Vec<(f64, f64)>);

fn panel<const N: usize>(y: &'static str, series: [Curve<'_>; N]) -> Panel {
    let series = series.map(|(name, class, points)| Series { name: name.into(), class, points });
    Panel { y, log: false, series: series.into() }
}

/// The periodogram `ts |FFT|² / N`, averaged over neighbouring bins, without the mean.
fn spectrum(v: &[f64], ts: f64) -> Vec<(f64, f64)> {
    let n = v.len();
    if n < 8 {
        return Vec::new();
    }
    let mean = v.iter().sum::<f64>() / n as f64;
    let mut input: Vec<f64> = v.iter().map(|x| x - mean).collect();
    let power: Vec<f64> = spectrum::power(&mut input).iter().map(|p| p * ts / n as f64).collect();
    (1..power.len())
        .map(|i| {
            let near = &power[i.saturating_sub(SMOOTHED).max(1)..(i + SMOOTHED + 1).min(power.len())];
            (i as f64 / (n as f64 * ts), near.iter().sum::<f64>() / near.len() as f64)
        })
        .collect()
}

fn autocorrelation(v: &[f64]) -> Vec<(f64, f64)> {
    let mean = v.iter().sum::<f64>() / v.len().max(1) as f64;
    let e: Vec<f64> = v.iter().map(|x| x - mean).collect();
    let power: f64 = e.iter().map(|x| x * x).sum();
    let at = |lag: usize| e.iter().zip(e.iter().skip(lag)).map(|(a, b)| a * b).sum::<f64>();
    (1..=LAGS.min(v.len().saturating_sub(1)))
        .filter(|_| power > 0.0)
        .map(|lag| (lag as f64, at(lag) / power))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spectrum_of_a_sine_peaks_at_its_frequency() {
        let v: Vec<f64> = (0..1000).map(|k| (0.1 * std::f64::consts::TAU * f64::from(k)).sin()).collect();
        let spectrum = spectrum(&v, 2.0);
        let peak = spectrum.iter().max_by(|a, b| a.1.total_cmp(&b.1)).expect("bins");
        // 0.1 per sample of 2 s; the average spreads the line over its neighbours.
        assert!((peak.0 - 0.05).abs() < 0.0015, "{peak:?}");
        // Parseval: the integral over frequency is half the variance, for one side.
        let integral: f64 = spectrum.iter().map(|p| p.1 / 2000.0).sum();
        assert!((integral - 0.25).abs() < 0.01, "{integral}");
    }

    #[test]
    fn the_autocorrelation_by_hand() {
        let r = autocorrelation(&[1.0, -1.0, 1.0, -1.0]);
        assert_eq!(r[..2], [(1.0, -0.75), (2.0, 0.5)]);
        assert!(autocorrelation(&[]).is_empty());
    }
}
