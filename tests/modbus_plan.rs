//! Request planning against cases written as data: tests/cases/modbus_plan/*.toml.

use serde::Deserialize;
use std::path::Path;
use stictiond::collect::modbus::{Config, Plan, Register, Request, Span, TagConfig, TagSpec};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Case {
    about: String,
    device: Config,
    tag: Vec<TagConfig>,
    request: Vec<Expected>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Expected {
    register: Register,
    start: u16,
    count: u16,
    tags: Vec<usize>,
}

#[test]
fn requests_are_planned_as_the_cases_expect() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cases/modbus_plan");
    let mut paths: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    assert!(paths.len() >= 8, "the cases are gone: {paths:?}");
    for path in paths {
        let case: Case = toml::from_str(&std::fs::read_to_string(&path).unwrap())
            .unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let specs = case.tag.into_iter().enumerate().map(|(index, config)| TagSpec {
            index,
            name: format!("tag {index}"),
            role: None,
            config,
            frozen_after_s: None,
        });
        let plan = Plan::new(0, &case.device, specs.collect())
            .unwrap_or_else(|issues| panic!("{}: {issues:?}", path.display()));
        let expected: Vec<Request> = case
            .request
            .into_iter()
            .map(|Expected { register, start, count, tags }| Request {
                span: Span { register, start, count },
                tags,
            })
            .collect();
        assert_eq!(plan.requests, expected, "{}: {}", path.display(), case.about);
    }
}
