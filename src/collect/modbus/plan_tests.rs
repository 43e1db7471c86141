use super::*;
use crate::signal::Role;
use proptest::prelude::*;

fn any_span() -> impl Strategy<Value = Span> {
    let register =
        prop::sample::select(vec![Register::Holding, Register::Input, Register::Coil, Register::Discrete]);
    let start = prop_oneof![0u16..300, 65400u16..=65535, any::<u16>()];
    (register, start, prop::sample::select(vec![1u16, 2, 4])).prop_map(|(register, start, count)| Span {
        register,
        start: start.min(u16::MAX - (count - 1)),
        count: if register.is_bits() { 1 } else { count },
    })
}

fn any_limits() -> impl Strategy<Value = Limits> {
    (4u16..=125, 1u16..=2000, 0u16..=125).prop_map(|(registers, bits, gap)| Limits { registers, bits, gap })
}

fn tag(span: Span) -> Tag {
    let text = "device = 'd'\nregister = 'holding'\naddress = 0";
    let config: TagConfig = toml::from_str(text).unwrap();
    Tag {
        index: 0,
        name: String::new(),
        span,
        decoder: Decoder::new(&config, ValueType::U16, Default::default(), None),
        frozen_after_s: None,
    }
}

fn covers(request: &Request, span: Span) -> bool {
    request.span.register == span.register
        && request.span.start <= span.start
        && span.end() <= request.span.end()
}

proptest! {
    #[test]
    fn every_tag_is_covered_once_and_the_limits_are_kept(
        spans in prop::collection::vec(any_span(), 0..120), limits in any_limits(),
    ) {
        let requests = group(&spans, &limits);
        let mut served: Vec<usize> = requests.iter().flat_map(|r| r.tags.clone()).collect();
        served.sort_unstable();
        prop_assert_eq!(served, (0..spans.len()).collect::<Vec<_>>());
        for request in &requests {
            let most = if request.span.register.is_bits() { limits.bits } else { limits.registers };
            prop_assert!(request.span.count <= most && request.span.end() <= 65536);
            let mut end = u32::from(request.span.start);
            for &at in &request.tags {
                prop_assert!(covers(request, spans[at]));
                prop_assert!(u32::from(spans[at].start) <= end + u32::from(limits.gap));
                end = end.max(spans[at].end());
            }
            prop_assert_eq!(end, request.span.end(), "nothing is read past the last tag");
        }
    }

    #[test]
    fn neighbouring_requests_could_not_be_one(
        spans in prop::collection::vec(any_span(), 0..120), limits in any_limits(),
    ) {
        let requests = group(&spans, &limits);
        for pair in requests.windows(2) {
            let next = spans[pair[1].tags[0]];
            prop_assert_eq!(join(pair[0].span, next, &limits), None);
        }
    }

    #[test]
    fn splitting_loses_no_tag_and_ends(spans in prop::collection::vec(any_span(), 1..60)) {
        let limits = Limits { registers: 125, bits: 2000, gap: 20 };
        let tags: Vec<Tag> = spans.iter().copied().map(tag).collect();
        let mut open = group(&spans, &limits);
        let mut closed = Vec::new();
        let mut steps = 0;
        while let Some(request) = open.pop() {
            steps += 1;
            prop_assert!(steps <= 2 * spans.len(), "a tree of n leaves has fewer than 2 n nodes");
            match request.split(&tags) {
                Some((a, b)) => {
                    prop_assert!(a.span.end() <= u32::from(b.span.start), "no address is asked for twice");
                    open.extend([a, b]);
                }
                None => {
                    prop_assert!(request.tags.iter().all(|&at| covers(&request, spans[at])));
                    closed.extend(request.tags);
                }
            }
        }
        closed.sort_unstable();
        prop_assert_eq!(closed, (0..spans.len()).collect::<Vec<_>>());
    }
}

#[test]
fn a_refused_request_is_divided_at_its_widest_hole() {
    let at = |start, count| Span { register: Register::Holding, start, count };
    let spans = [at(10, 2), at(12, 1), at(20, 2), at(23, 1)];
    let tags: Vec<Tag> = spans.into_iter().map(tag).collect();
    let all = &group(&spans, &Limits { registers: 125, bits: 2000, gap: 8 })[0];
    let (left, right) = all.split(&tags).unwrap();
    assert_eq!((left.span, &left.tags[..]), (at(10, 3), &[0, 1][..]));
    assert_eq!((right.span, &right.tags[..]), (at(20, 4), &[2, 3][..]));
    let (left, right) = left.split(&tags).unwrap();
    assert_eq!((left.span, right.span), (at(10, 2), at(12, 1)));
    assert_eq!(left.split(&tags), None);
}

#[test]
fn every_fault_is_reported_with_the_tags_name() {
    let device: Config = toml::from_str("name='d'\naddress='nowhere'\naddress_base=0").unwrap();
    let spec = |name: &str, text: &str| TagSpec {
        index: 0,
        name: name.into(),
        role: None,
        config: toml::from_str(&format!("device='d'\nregister='holding'\n{text}")).unwrap(),
        frozen_after_s: None,
    };
    let specs = vec![
        spec("A.pv", "address=65536\ntype='u16'"),
        spec("A.op", "address=9\ntype='f32'"),
        spec("A.sp", "address=10\ntype='u16'"),
    ];
    let issues = Plan::new(0, &device, specs).unwrap_err();
    let lines: Vec<String> = issues.iter().map(|i| format!("{}: {}", i.field, i.message)).collect();
    assert_eq!(lines.len(), 3, "{lines:?}");
    assert!(lines[0].starts_with("address: 'nowhere'"));
    assert!(lines[1].starts_with("address: A.op, A.sp: "));
    assert!(lines[2].starts_with("address: A.pv: 65536 must be 0 to 65535"));
}

#[test]
fn the_role_and_the_devices_byte_order_reach_the_decoder() {
    let device: Config =
        toml::from_str("name='d'\naddress='h:502'\naddress_base=1\nbyte_order='DCBA'").unwrap();
    let spec = |index, role, text: &str| TagSpec {
        index,
        name: "A".into(),
        role,
        config: toml::from_str(&format!("device='d'\n{text}")).unwrap(),
        frozen_after_s: None,
    };
    let specs = vec![
        spec(7, Some(Role::Mode), "register='holding'\naddress=1\ntype='u16'\nauto_values=[2]"),
        spec(8, Some(Role::Pv), "register='holding'\naddress=2\ntype='u32'"),
        spec(9, None, "register='holding'\naddress=4\ntype='u32'\nbyte_order='ABCD'"),
        spec(10, None, "register='coil'\naddress=1"),
    ];
    let plan = Plan::new(3, &device, specs).unwrap();
    let value = |tag: usize, words: &[u16]| plan.tags[tag].decoder.decode(words).unwrap().value;
    assert_eq!((value(0, &[0x0200]), value(0, &[0x0002])), (1.0, 0.0));
    assert_eq!(value(1, &[0x0100, 0x0000]), 1.0);
    assert_eq!(value(2, &[0x0000, 0x0001]), 1.0);
    assert_eq!(value(3, &[1]), 1.0, "a coil has no bytes to swap");
    assert_eq!(plan.tags.iter().map(|tag| tag.index).collect::<Vec<_>>(), [7, 8, 9, 10]);
    assert_eq!((plan.device, plan.requests.len(), plan.requests[0].span.start), (3, 2, 0));
}
