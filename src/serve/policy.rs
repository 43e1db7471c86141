//! What each route needs: one table, which the router obeys, `docs/security.md` shows and a test holds against the
//! description of the API. What does not stand here is not answered.

use crate::access::Role;
use axum::http::Method;

/// What a route needs of who asks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// Nothing: it tells nothing of the plant.
    Nothing,
    /// A role that includes this one. `viewer` is had by everybody where `anyone_may_read` says so.
    Role(Role),
}

impl Need {
    /// As it is written in documents.
    pub fn as_str(self) -> &'static str {
        match self {
            Need::Nothing => "nothing",
            Need::Role(role) => role.as_str(),
        }
    }
}

const NOTHING: Need = Need::Nothing;
const VIEWER: Need = Need::Role(Role::Viewer);
const OPERATOR: Need = Need::Role(Role::Operator);
const ENGINEER: Need = Need::Role(Role::Engineer);
const APPROVER: Need = Need::Role(Role::Approver);

/// Method, path below `/api/v1` (health, metrics and the description at the root too), and what it needs.
pub const RULES: &[(&str, &str, Need)] = &[
    ("GET", "/healthz", NOTHING),
    ("GET", "/readyz", NOTHING),
    ("GET", "/openapi.json", NOTHING),
    ("GET", "/metrics", VIEWER),
    ("GET", "/session", NOTHING),
    ("POST", "/session", NOTHING),
    ("DELETE", "/session", NOTHING),
    ("GET", "/loops", VIEWER),
    ("GET", "/loops/{id}", VIEWER),
    ("GET", "/loops/{id}/diagnosis", VIEWER),
    ("POST", "/loops/{id}/diagnosis", OPERATOR),
    ("GET", "/loops/{id}/diagnoses", VIEWER),
    ("GET", "/loops/{id}/samples", VIEWER),
    ("GET", "/loops/{id}/model", VIEWER),
    ("GET", "/loops/{id}/evidence", VIEWER),
    ("GET", "/loops/{id}/opinions/{method}", VIEWER),
    ("GET", "/loops/{id}/live", VIEWER),
    ("GET", "/loops/{id}/report.html", VIEWER),
    ("GET", "/report.html", VIEWER),
    ("GET", "/loops/{id}/bundle", ENGINEER),
    ("GET", "/alarms", VIEWER),
    ("GET", "/alarms/history", VIEWER),
    ("POST", "/alarms/{id}/ack", OPERATOR),
    ("POST", "/alarms/{id}/shelve", OPERATOR),
    ("POST", "/alarms/{id}/unshelve", OPERATOR),
    ("POST", "/alarms/{id}/reset", OPERATOR),
    ("POST", "/alarms/{id}/out-of-service", ENGINEER),
    ("POST", "/alarms/{id}/in-service", ENGINEER),
    ("GET", "/notifications", VIEWER),
    ("GET", "/notifications/{receiver}/dead-letters", ENGINEER),
    ("POST", "/notifications/{receiver}/replay", ENGINEER),
    ("GET", "/events", VIEWER),
    ("GET", "/collectors", VIEWER),
    ("GET", "/system", VIEWER),
    ("GET", "/fleet", VIEWER),
    ("GET", "/map", VIEWER),
    ("GET", "/audit", ENGINEER),
    ("GET", "/backfill", VIEWER),
    ("POST", "/backfill", ENGINEER),
    ("DELETE", "/backfill", ENGINEER),
    ("GET", "/groups", VIEWER),
    ("POST", "/groups", OPERATOR),
    ("GET", "/groups/{number}", VIEWER),
    ("GET", "/work", VIEWER),
    ("GET", "/work.csv", VIEWER),
    ("GET", "/work.html", VIEWER),
    ("POST", "/work/{id}/order", OPERATOR),
    ("POST", "/work/{id}/repaired", OPERATOR),
    ("POST", "/work/{id}/dismiss", OPERATOR),
    ("POST", "/work/{id}/reopen", OPERATOR),
    ("GET", "/loops/{id}/indicators", VIEWER),
    ("GET", "/loops/{id}/writeback", VIEWER),
    ("POST", "/loops/{id}/writeback/grant", APPROVER),
    ("POST", "/loops/{id}/writeback/approve", APPROVER),
    ("POST", "/loops/{id}/writeback/withdraw", OPERATOR),
    ("POST", "/loops/{id}/writeback/reset", APPROVER),
];

/// Streams: who has opened one listens, and a browser opens it again by itself.
const STREAMS: [&str; 2] = ["/api/v1/events", "/api/v1/loops/{id}/live"];

/// Whether a route, as the router knows it, is a stream.
pub fn is_stream(route: &str) -> bool {
    STREAMS.contains(&route)
}

/// What stands for a path, of a route as the router knows it: its methods and needs; empty where there is none.
pub fn of_path(route: &str) -> Vec<(&'static str, Need)> {
    if super::page::has(route) {
        return vec![("GET", NOTHING)];
    }
    // An alarm's name may come in two halves; what may be done to it is the same.
    let path = route.strip_prefix("/api/v1").unwrap_or(route).replace("/{id}/{kind}/", "/{id}/");
    RULES.iter().filter(|(_, known, _)| *known == path).map(|(method, _, need)| (*method, *need)).collect()
}

/// What a method of a path needs, HEAD as GET; `None` where it is not answered.
pub fn need(rules: &[(&str, Need)], method: &Method) -> Option<Need> {
    let method = if method == Method::HEAD { "GET" } else { method.as_str() };
    rules.iter().find(|(known, _)| *known == method).map(|(_, need)| *need)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    /// Every operation of the description has a rule, and every rule an operation.
    #[test]
    fn a_route_without_an_entry_cannot_exist() {
        let api = serde_json::to_value(super::super::openapi()).expect("the description is JSON");
        let mut described = BTreeSet::from([("GET".to_string(), "/openapi.json".to_string())]);
        for (path, methods) in api["paths"].as_object().expect("paths") {
            for method in methods.as_object().expect("methods").keys() {
                let below = path.strip_prefix("/api/v1").unwrap_or(path);
                described.insert((method.to_uppercase(), below.to_string()));
            }
        }
        let acts = |path: &str| path.contains("/writeback/");
        let ruled: BTreeSet<(String, String)> = RULES
            .iter()
            .filter(|(_, path, _)| cfg!(feature = "writeback") || !acts(path))
            .map(|(method, path, _)| (method.to_string(), path.to_string()))
            .collect();
        assert_eq!(described, ruled);
        assert_eq!(RULES.len(), RULES.iter().map(|(m, p, _)| (m, p)).collect::<BTreeSet<_>>().len());
    }

    #[test]
    fn no_change_needs_less_than_an_operator_but_the_log_in() {
        for (method, path, need) in RULES.iter().filter(|(method, ..)| *method != "GET") {
            let least = matches!(need, Need::Role(role) if role.includes(Role::Operator));
            assert!(least || *path == "/session", "{method} {path}");
        }
    }

    #[test]
    fn every_stream_is_known_as_one() {
        let api = serde_json::to_value(super::super::openapi()).expect("the description is JSON");
        let is_stream = |methods: &serde_json::Value| {
            methods["get"]["responses"]["200"]["content"]["text/event-stream"].is_object()
        };
        let paths = api["paths"].as_object().expect("paths");
        let described: BTreeSet<&str> =
            paths.iter().filter(|(_, methods)| is_stream(methods)).map(|(path, _)| path.as_str()).collect();
        assert_eq!(described, BTreeSet::from(STREAMS));
        assert!(STREAMS.iter().all(|route| super::is_stream(route)) && !super::is_stream("/api/v1/loops"));
    }

    #[test]
    fn a_method_that_has_no_entry_is_not_answered() {
        let rules = of_path("/api/v1/loops/{id}/diagnosis");
        assert_eq!(need(&rules, &Method::HEAD), Some(VIEWER));
        assert_eq!(need(&rules, &Method::POST), Some(OPERATOR));
        assert_eq!(need(&rules, &Method::PUT), None);
        assert_eq!(of_path("/api/v1/alarms/{id}/{kind}/out-of-service"), [("POST", ENGINEER)]);
        assert_eq!(of_path("/api/v1/new"), []);
        assert_eq!(of_path("/js/main.js"), [("GET", NOTHING)]);
    }
}
