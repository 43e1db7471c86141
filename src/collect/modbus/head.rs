//! Whether an answer whose head is not the request's may be taken for its answer. Pure.

use super::config::Tolerated;

/// Unit identifiers by which gateways mean themselves.
const OWN_UNITS: [u16; 3] = [0, 1, 255];

/// The head of a request or an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Head {
    /// Not in frames of RTU.
    transaction: Option<u16>,
    unit: u16,
}

/// Judges a mismatch, which the client library tells in words: `expected/request = Header { transaction_id: 3, unit_id: 1 },
/// actual/response = …`.
///
/// # Errors
/// What differs, and the option by which it would be taken.
pub(super) fn judge(told: &str, tolerate: &[Tolerated]) -> Result<(), String> {
    let heads =
        told.split_once("actual/response").and_then(|(asked, came)| Some((head(asked)?, head(came)?)));
    let Some((asked, came)) = heads else {
        return Err(format!("the answer does not belong to the request: {told}"));
    };
    let takes = |what| tolerate.contains(&what);
    if let (Some(sent), Some(back)) = (asked.transaction, came.transaction)
        && sent != back
        && !takes(Tolerated::TransactionId)
    {
        return Err(format!(
            "the answer has the transaction id {back}, not {sent}: if this gateway always answers so, write tolerate = \
             [\"transaction_id\"]"
        ));
    }
    let (sent, back) = (asked.unit, came.unit);
    if sent == back || OWN_UNITS.contains(&back) && takes(Tolerated::UnitId) {
        return Ok(());
    }
    let hint = if OWN_UNITS.contains(&back) {
        "if this gateway always answers so, write tolerate = [\"unit_id\"]"
    } else {
        "it is another device's"
    };
    Err(format!("the answer has the unit id {back}, not {sent}: {hint}"))
}

fn head(told: &str) -> Option<Head> {
    let number = |name: &str| -> Option<u16> {
        let (_, rest) = told.split_once(name)?;
        let digits = rest.trim_start_matches([':', ' ']);
        let end = digits.find(|c: char| !c.is_ascii_digit()).unwrap_or(digits.len());
        digits[..end].parse().ok()
    };
    Some(Head {
        transaction: number("transaction_id"),
        unit: number("unit_id").or_else(|| number("slave_id"))?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use Tolerated::{TransactionId, UnitId};

    fn told(asked: (u16, u8), came: (u16, u8)) -> String {
        let head =
            |(transaction, unit)| format!("Header {{ transaction_id: {transaction}, unit_id: {unit} }}");
        format!("expected/request = {}, actual/response = {}", head(asked), head(came))
    }

    #[test]
    fn what_differs_is_named_with_the_option_and_taken_by_it_alone() {
        let number = told((3, 7), (0, 7));
        let why = judge(&number, &[]).unwrap_err();
        assert!(why.contains("transaction id 0, not 3") && why.contains("[\"transaction_id\"]"), "{why}");
        assert!(judge(&number, &[UnitId]).is_err());
        assert_eq!(judge(&number, &[TransactionId]), Ok(()));
        for own in [0, 1, 255] {
            let unit = told((3, 7), (3, own));
            let why = judge(&unit, &[]).unwrap_err();
            assert!(why.contains(&format!("unit id {own}, not 7")) && why.contains("[\"unit_id\"]"), "{why}");
            assert!(judge(&unit, &[TransactionId]).is_err());
            assert_eq!(judge(&unit, &[UnitId]), Ok(()));
        }
        let other = judge(&told((3, 7), (3, 8)), &[UnitId, TransactionId]).unwrap_err();
        assert!(other.contains("another device"), "{other}");
        assert!(judge(&told((3, 7), (4, 0)), &[UnitId]).is_err());
        assert_eq!(judge(&told((3, 7), (4, 0)), &[UnitId, TransactionId]), Ok(()));
    }

    #[test]
    fn frames_of_rtu_have_a_unit_only_and_what_is_not_understood_is_refused() {
        let rtu = "expected/request = Header { slave_id: 7 }, actual/response = Header { slave_id: 1 }";
        assert_eq!(judge(rtu, &[UnitId]), Ok(()));
        assert!(judge(rtu, &[]).is_err());
        assert!(judge("something else", &[UnitId, TransactionId]).is_err());
    }
}
