//! Which loops are expected to calm down with which, as the work list says it to the results.

use crate::results::SourceOrder;
use crate::signal::LoopId;
use crate::work::WorkList;
use std::collections::HashMap;

/// Of each loop that is expected to calm down with one whose order stands, that order.
pub(super) fn swings(list: &WorkList) -> HashMap<LoopId, SourceOrder> {
    let order = |source: LoopId| {
        let own = list.get(&source)?;
        let (state, since) = (own.state.as_str(), own.since);
        Some(SourceOrder { source, state, since, by: own.by.clone(), note: own.note.clone() })
    };
    let sources = list.sources().into_iter();
    sources.filter_map(|(victim, source)| Some((victim, order(source)?))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::work::{Order, State};

    #[test]
    fn a_victim_has_the_order_of_its_source_while_that_stands() {
        let [source, victim] = ["FIC1", "LIC1"].map(LoopId::new);
        let of = |state: State| {
            let mut list = WorkList::default();
            let order = Order {
                state,
                since: 60.0,
                by: Some("ann".into()),
                note: Some("4711".into()),
                victims: vec![victim.clone()],
                ..Order::new(source.clone(), 0.0)
            };
            list.restore(vec![order]);
            swings(&list)
        };
        let own = SourceOrder {
            source: source.clone(),
            state: "ordered",
            since: 60.0,
            by: Some("ann".into()),
            note: Some("4711".into()),
        };
        assert_eq!(of(State::Ordered), HashMap::from([(victim.clone(), own)]));
        assert_eq!(of(State::Repaired), HashMap::new());
    }
}
