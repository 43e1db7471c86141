//! What is counted of the rows of one tag beside a column of words.

/// Rows of one word from which they are a block.
const BLOCK: u64 = 3;
/// Share of a block within which the next one begins, where the times begin again.
const AGAIN: f64 = 0.1;
/// Share by which a step of an even clock may differ from the step before.
const EVEN: f64 = 0.2;

/// OP and PV; where a row has one value, that and none.
pub type Values = [Option<f64>; 2];

/// A row as it is compared with others.
#[derive(Clone, Copy, Debug, Default)]
pub struct Row {
    /// By which rows of one time are known.
    pub stamp: u64,
    /// Its time, in whatever it is counted; `None` where it cannot be read.
    pub time: Option<f64>,
    /// Its values.
    pub values: Values,
}

/// The rows of one word.
#[derive(Clone, Debug, Default)]
pub struct Own {
    /// Its place among the words of the column.
    pub word: usize,
    /// How many there are.
    pub rows: u64,
    /// Those that stand alone: the row before and the row behind have another word.
    pub alone: u64,
    time: Option<f64>,
    step: Option<f64>,
    values: Values,
}

impl Own {
    /// One more; `steps` are counted, and those that are as long as the step before.
    fn add(&mut self, row: &Row, steps: &mut [u64; 2]) {
        self.rows += 1;
        keep(&mut self.values, row.values);
        let Some(time) = row.time else { return };
        let Some(before) = self.time.replace(time) else { return };
        let step = time - before;
        if let Some(last) = self.step.replace(step) {
            steps[0] += 1;
            steps[1] += u64::from((step - last).abs() <= EVEN * last.abs());
        }
    }
}

/// Rows of one word, one behind the other.
#[derive(Clone, Copy, Debug, Default)]
struct Block {
    rows: u64,
    first: Option<f64>,
    last: Option<f64>,
    values: Values,
}

impl Block {
    fn begin(row: &Row) -> Self {
        Self { rows: 1, first: row.time, last: row.time, values: row.values }
    }

    fn go_on(&mut self, row: &Row) {
        self.rows += 1;
        self.last = row.time.or(self.last);
        self.first = self.first.or(row.time);
    }

    /// Whether the times begin again with a row behind it; a copy of its rows is none of another loop.
    fn begins_again(&self, row: &Row) -> bool {
        let (Some(first), Some(last), Some(time)) = (self.first, self.last, row.time) else { return false };
        let is_copy = time == first && row.values == self.values;
        self.rows >= BLOCK && first != last && !is_copy && (time - first) / (last - first) <= AGAIN
    }
}

/// Takes the values that are there.
fn keep(kept: &mut Values, values: Values) {
    kept.iter_mut().zip(values).for_each(|(own, value)| *own = value.or(*own));
}

/// What is counted of a tag.
#[derive(Clone, Debug, Default)]
pub struct Track {
    /// Its words.
    pub own: Vec<Own>,
    /// Its rows with a word, and those of them that have it from the row above.
    pub rows: u64,
    /// See `rows`.
    pub blanks: u64,
    /// Rows with another word than the row before.
    pub changes: u64,
    /// Changes of the word at which the times begin again.
    pub begins: u64,
    /// Steps from one row of a word to its next, and those that are as long as the step before.
    pub steps: [u64; 2],
    /// Rows at the time of the row before, those of them with a word that no other row of this time has, and of these those with
    /// other values than the row before.
    pub same: [u64; 3],
    /// Of each value: changes of the word, and those at which it is nearer to the last value of its own word than to that of the
    /// row before.
    pub nearer: [[u64; 2]; 2],
    last: Option<usize>,
    stamp: Option<u64>,
    at_stamp: Vec<usize>,
    before: Values,
    block: Block,
}

impl Track {
    /// The word of the row before.
    pub fn word(&self) -> Option<usize> {
        self.last.map(|place| self.own[place].word)
    }

    /// One more row with this word; whether the tag had it never before.
    pub fn add(&mut self, word: usize, row: &Row) -> bool {
        self.rows += 1;
        let known = self.own.iter().position(|own| own.word == word);
        let place = known.unwrap_or(self.own.len());
        if known.is_none() {
            self.own.push(Own { word, ..Own::default() });
        }
        self.at_one_time(place, row);
        match self.last.replace(place) {
            Some(last) if last == place => self.block.go_on(row),
            Some(last) => self.change(last, place, row),
            None => self.block = Block::begin(row),
        }
        self.own[place].add(row, &mut self.steps);
        keep(&mut self.before, row.values);
        known.is_none()
    }

    fn at_one_time(&mut self, place: usize, row: &Row) {
        if self.stamp.replace(row.stamp) != Some(row.stamp) {
            self.at_stamp.clear();
            self.at_stamp.push(place);
            return;
        }
        let is_new = !self.at_stamp.contains(&place);
        let mut pairs = row.values.into_iter().zip(self.before);
        let differs = pairs.any(|(own, before)| own.is_some() && before.is_some() && own != before);
        self.same[0] += 1;
        self.same[1] += u64::from(is_new);
        self.same[2] += u64::from(is_new && differs);
        if is_new {
            self.at_stamp.push(place);
        }
    }

    fn change(&mut self, last: usize, place: usize, row: &Row) {
        self.changes += 1;
        self.own[last].alone += u64::from(self.block.rows == 1);
        self.begins += u64::from(self.block.begins_again(row));
        self.block = Block::begin(row);
        let of_word = self.own[place].values;
        let values = row.values.into_iter().zip(self.before).zip(of_word);
        for (nearer, ((value, before), own)) in self.nearer.iter_mut().zip(values) {
            let (Some(value), Some(before), Some(own)) = (value, before, own) else { continue };
            let (to_row, to_own) = ((value - before).abs(), (value - own).abs());
            if to_row > 0.0 || to_own > 0.0 {
                nearer[0] += 1;
                nearer[1] += u64::from(2.0 * to_own < to_row);
            }
        }
    }
}
