//! Rates.
#[path = "../tests/generators/mod.rs"]
mod generators;
#[path = "../tests/diagnosis_common/parallel.rs"]
mod parallel;

use generators::{Case, Generator, Size};
use std::collections::BTreeMap;
use std::time::Instant;
use stictiond_numerics::diagnosis::{self, gate, region};
use stictiond_numerics::residual::Kind;
use stictiond_numerics::residual_new::forward_selection::{compare, table};
use stictiond_numerics::residual_new::hypothesis::Hypothesis;
use stictiond_numerics::sysid::iddata::IdData;
use stictiond_numerics::sysid::valve::Start;

fn main() {
    let mut args = std::env::args().skip(1);
    let mut gens = "AB".to_string();
    let mut seeds = 0..1u64;
    let mut kinds: Vec<Option<Kind>> = Vec::new();
    let mut each = false;
    let mut variant = None;
    while let Some(a) = args.next() {
        match a.as_str() {
            "--gen" => gens = args.next().unwrap(),
            "--seed" => {
                let s: u64 = args.next().unwrap().parse().unwrap();
                seeds = s..s + 1;
            }
            "--seeds" => {
                let n: u64 = args.next().unwrap().parse().unwrap();
                seeds.end = seeds.start + n;
            }
            "--kind" => {
                let k = args.next().unwrap();
                kinds.extend(k.split(',').map(|k| Kind::ALL.into_iter().find(|x| x.as_str() == k)));
            }
            "--variant" => variant = Some(args.next().unwrap().parse::<usize>().unwrap()),
            "--each" => each = true,
            _ => panic!("{a}"),
        }
    }
    if kinds.is_empty() {
        let direct = [Kind::QuantisedPv, Kind::Outliers, Kind::FrozenPv, Kind::ClockSkew, Kind::SlipJump];
        kinds = Kind::ALL.into_iter().filter(|k| !direct.contains(k)).map(Some).chain([None]).collect();
    }
    for g in [generators::a::A, generators::b::B, generators::c::C] {
        if gens.contains(g.name) {
            rates(&g, &seeds, &kinds, variant, each);
        }
    }
}

#[derive(Clone)]
struct Out {
    case: Case,
    name: String,
    f: f64,
    kinds: Vec<(Option<Kind>, f64)>,
    sticks: f64,
    found_f: f64,
    ms: f64,
}

fn judge(g: &Generator, case: &Case) -> Option<Out> {
    let (record, truth) = (g.record)(case);
    if let Ok(dir) = std::env::var("DUMP") {
        use std::fmt::Write;
        let mut out = String::from("t,op,pv,sp");
        record.tags.iter().for_each(|t| write!(out, ",{}", t.0).unwrap());
        out.push('\n');
        for k in 0..record.op.len().min(record.pv.len()) {
            write!(out, "{},{},{},{}", record.op[k].t, record.op[k].value, record.pv[k].value, record.sp.as_ref().map_or(0.0, |s| s[k.min(s.len()-1)].value)).unwrap();
            for t in &record.tags { write!(out, ",{}", t.1[k.min(t.1.len()-1)].value).unwrap(); }
            out.push('\n');
        }
        std::fs::write(format!("{dir}/{}.{}.{}.{}.csv", g.name, case.effect.map_or("clean".into(), |k| k.to_string()), case.variant, case.seed), out).unwrap();
        return None;
    }
    let (window, _) = gate::gate(&record, &diagnosis::Settings::default()).ok()?;
    let found = region::analyse(&window.op);
    let start = region::start_of(&found, &window.op, 0, window.len() / 3)
        .map_or(Start { index: 0, is_max: true }, |s| Start { index: s.index, is_max: s.is_max });
    let data = IdData::new(&window, start)?;
    let t = Instant::now();
    let effects = Hypothesis::default();
    let mut pool = Vec::new();
    if std::env::var("INFORMED").is_ok() && truth.f > 0.0 {
        use stictiond_numerics::sysid::valve::{Rest, StopRule, ValveModel};
        let s = 2.0 * truth.f / data.units.u;
        let js: Vec<f64> = if truth.j.is_finite() { vec![truth.j / data.units.u] } else { [0.15, 0.3, 0.45, 0.6].map(|r| r * s).to_vec() };
        for rule in StopRule::ALL {
            for &j in &js {
                for beyond in (if j > 0.9 * s && rule == StopRule::Slip { (0..=10).map(|i| 0.1 * f64::from(i)).collect::<Vec<_>>() } else { vec![0.0, 0.5, 1.0] }) {
                    for turned in [false, true] {
                        pool.push(ValveModel { s, j, rule, rest: Rest { turned, beyond }, ..ValveModel::default() });
                    }
                }
            }
        }
    }
    let decided = compare(&data, &effects, &mut pool, if std::env::var("INFORMED").is_ok() { case.effect } else { None });
    let ms = t.elapsed().as_secs_f64() * 1e3;
    let table = table(&decided, &effects);
    let kinds = table.kinds();
    if std::env::var("STEP").is_ok() {
        use stictiond_numerics::residual_new::decide::*;
        let mut valves: Vec<_> = pool.iter().take(4).map(|v| Some(*v)).collect();
        valves.push(None);
        let mut all = Vec::new();
        let mut null = f64::NEG_INFINITY;
        for valve in valves {
            let base = Hypothesis { valve, effects: vec![] };
            let d0 = decide(&data, base.clone(), None);
            null = null.max(d0.score);
            for at in (data.first + 10..data.split - 10).step_by(4) {
                let d = decide(&data, base.with(stictiond_numerics::residual_new::hypotheses::load::load_step::informed(at)), None);
                all.push(d);
            }
        }
        all.sort_by(|a, b| b.score.total_cmp(&a.score));
        let b = refine(&data, all[0].clone());
        println!("{} null {null:.1} best with step {:.1} {:?} of first {} split {}", truth.name, b.score, b.hypothesis, data.first, data.split);
    }
    if std::env::var("GAIN").is_ok() {
        use stictiond_numerics::residual_new::decide::*;
        for valve in [None].into_iter().chain(pool.iter().take(3).map(|v| Some(*v))) {
            let base = Hypothesis { valve, effects: vec![] };
            let d0 = decide(&data, base.clone(), None);
            println!("base {:?} {:.1}", valve.map(|v| v.s * data.units.u), d0.score);
            let mut best = None::<Decided>;
            for at in (data.first + 10..data.split - 10).step_by(8) {
                let d = decide(&data, base.with(stictiond_numerics::residual_new::hypotheses::process::gain_change::informed(at, 0.1)), None);
                if best.as_ref().is_none_or(|b| d.score > b.score) { best = Some(d); }
            }
            let b = refine(&data, best.unwrap());
            println!("   {:.1} {:?} nk {} b {:?} a {:?} c {:?}", b.score, b.hypothesis.effects, b.model.nk, b.model.b, b.model.a, b.model.c);
        }
    }
    let odds = table.log_odds(|d| d.hypothesis.valve.is_some());
    let best = table.best(kinds[0].0)?;
    if std::env::var("ROWS").is_ok() {
        let mut rows: Vec<_> = decided.iter().collect();
        rows.sort_by(|a, b| b.score.total_cmp(&a.score));
        println!("{} f {:.3} turns {}", truth.name, truth.f, { let (_, d) = Hypothesis { valve: Some(stictiond_numerics::sysid::valve::ValveModel::one_parameter(truth.f.max(1e-6) / data.units.u)), effects: vec![] }.stem(&data); stictiond_numerics::sysid::valve::reversals(&d) });
        for d in rows {
            println!(
                "  {:9.1} {:20} {:?} {:?} nk {}",
                d.score,
                d.kind().map_or("-".into(), |k| k.to_string()),
                d.hypothesis.valve.map(|v| format!("S {:.3} J {:.3} {:?}", v.s * data.units.u, v.j * data.units.u, v.rule)),
                d.hypothesis.effects,
                d.model.nk
            );
        }
    }
    Some(Out {
        case: *case,
        name: truth.name,
        f: truth.f,
        sticks: odds,
        found_f: best.hypothesis.valve.map_or(0.0, |v| v.f() * data.units.u),
        kinds,
        ms,
    })
}

fn rates(g: &Generator, seeds: &std::ops::Range<u64>, kinds: &[Option<Kind>], variant: Option<usize>, each: bool) {
    let mut total = (0, 0);
    let mut times = Vec::new();
    for &kind in kinds {
        let mut cases = Vec::new();
        for seed in seeds.clone() {
            for v in 0..(g.variants)(kind) {
                if variant.is_none_or(|w| w == v) {
                    let tags = if kind.is_none() { [0, 5, 20, 50][(v + seed as usize) % 4] } else { 3 };
                    cases.push(Case { effect: kind, size: Size::Medium, variant: v, seed, tags });
                }
            }
        }
        let out: Vec<Option<Out>> = parallel::each(&cases, |case| judge(g, case));
        let mut wrong: BTreeMap<String, usize> = BTreeMap::new();
        let (mut right, mut none, mut abstain, mut stick) = (0, 0, 0, [0; 4]);
        let n = out.len();
        for o in out.into_iter().flatten() {
            times.push(o.ms);
            let (k, p) = o.kinds[0];
            let named = if p > 0.5 { k } else { None };
            if o.f > 0.0 {
                stick[0] += 1;
                stick[1] += usize::from(o.sticks > 10.0);
            } else {
                stick[2] += 1;
                stick[3] += usize::from(o.sticks > 10.0);
            }
            if named == kind && p > 0.5 {
                right += 1;
                if !(each && o.f > 0.0 && (o.found_f / o.f - 1.0).abs() > 0.1) {
                    continue;
                }
            } else if p <= 0.5 {
                abstain += 1;
            } else if k.is_none() {
                none += 1;
            } else {
                *wrong.entry(k.unwrap().to_string()).or_default() += 1;
            }
            if each {
                let ks: Vec<String> = o.kinds.iter().take(3).map(|(k, p)| format!("{}:{:.2}", k.map_or("none".into(), |k| k.to_string()), p)).collect();
                println!("   {} v{} {} seed {} f {:.2} -> {:.2} odds {:.0} {} {:.0} ms", g.name, o.case.variant, o.name, o.case.seed, o.f, o.found_f, o.sticks, ks.join(" "), o.ms);
            }
        }
        total = (total.0 + right, total.1 + n);
        println!("{} {:22} right {right:3} of {n:3} none {none} abstain {abstain} wrong {wrong:?}  sticky {}/{} sound accused {}/{}", g.name, kind.map_or("clean".into(), |k| k.to_string()), stick[1], stick[0], stick[3], stick[2]);
    }
    if times.is_empty() { return; }
    times.sort_by(f64::total_cmp);
    println!("{} total {} of {}; ms median {:.0} 90% {:.0} max {:.0}", g.name, total.0, total.1, times[times.len() / 2], times[times.len() * 9 / 10], times[times.len() - 1]);
}
