//! What is counted of the rows of one tag beside a column of words.

/// Rows of one word from which they are a block.
const BLOCK: u64 = 3;
/// Share of a block before which the next one begins and beyond which it reaches, where the times begin again.
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
    /// The first and the last time of the block before, where the times may begin again.
    former: Option<[f64; 2]>,
}

impl Block {
    /// The first row behind a block of another word.
    fn begin(row: &Row, before: &Self) -> Self {
        Self {
            rows: 1,
            first: row.time,
            last: row.time,
            values: row.values,
            former: before.begins_again(row),
        }
    }

    fn go_on(&mut self, row: &Row) {
        self.rows += 1;
        self.last = row.time.or(self.last);
        self.first = self.first.or(row.time);
    }

    /// Its first and its last time, where they may begin again with a row behind it; a copy of its rows is none of another loop.
    fn begins_again(&self, row: &Row) -> Option<[f64; 2]> {
        let (first, last, time) = (self.first?, self.last?, row.time?);
        let is_copy = time == first && row.values == self.values;
        let may_be = self.rows >= BLOCK && first != last && !is_copy;
        (may_be && (time - first) / (last - first) <= AGAIN).then_some([first, last])
    }

    /// Whether a row of it lies among those of the block before, so that the times have begun again; it is told once. A block that lies
    /// wholly before the other is an earlier part of the same record.
    fn reaches(&mut self, row: &Row) -> bool {
        let (Some([first, last]), Some(time)) = (self.former, row.time) else { return false };
        let share = (time - first) / (last - first);
        let reaches = share > AGAIN && share <= 1.0;
        if reaches {
            self.former = None;
        }
        reaches
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
    /// Changes of the word at which the times begin again: the rows behind lie among those before.
    pub begins: u64,
    /// Steps from one row of a word to its next, and those that are as long as the step before.
    pub steps: [u64; 2],
    /// Rows at the time of the row before, those of them with a word that no other row of this time has, and of these those with
    /// other values than the rows of this time before.
    pub same: [u64; 3],
    /// Of each value: changes of the word, and those at which it is nearer to the last value of its own word than to that of the
    /// row before.
    pub nearer: [[u64; 2]; 2],
    last: Option<usize>,
    stamp: Option<u64>,
    at_stamp: Vec<usize>,
    /// The last values of this time.
    values_at_stamp: Values,
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
            Some(last) if last == place => {
                self.begins += u64::from(self.block.reaches(row));
                self.block.go_on(row);
            }
            Some(last) => self.change(last, place, row),
            None => self.block = Block::begin(row, &Block::default()),
        }
        self.own[place].add(row, &mut self.steps);
        keep(&mut self.before, row.values);
        known.is_none()
    }

    fn at_one_time(&mut self, place: usize, row: &Row) {
        if self.stamp.replace(row.stamp) != Some(row.stamp) {
            self.at_stamp.clear();
            self.at_stamp.push(place);
            self.values_at_stamp = row.values;
            return;
        }
        let is_new = !self.at_stamp.contains(&place);
        let mut pairs = row.values.into_iter().zip(self.values_at_stamp);
        let differs = pairs.any(|(own, before)| own.is_some() && before.is_some() && own != before);
        keep(&mut self.values_at_stamp, row.values);
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
        self.block = Block::begin(row, &self.block);
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
