//! A source file as the rules see it: the paths its code names, comments, strings and tests left out.

/// One source file.
pub struct Source {
    /// From the root of the package, with forward slashes.
    pub path: String,
    /// As it stands in the file.
    pub text: String,
}

impl Source {
    /// From memory.
    pub fn new(path: &str, text: &str) -> Self {
        Self { path: path.into(), text: text.into() }
    }

    /// `["serve", "api", "loops"]` for `src/serve/api/loops.rs`.
    pub fn module(&self) -> Vec<String> {
        let inner = self.path.trim_start_matches("src/").trim_end_matches(".rs");
        let inner = inner.trim_end_matches("/mod");
        inner.split('/').map(str::to_string).collect()
    }

    /// `serve` for `src/serve/api/loops.rs`.
    pub fn top(&self) -> String {
        self.module().swap_remove(0)
    }

    /// Compiled for tests only, by the names we give such files.
    pub fn is_test(&self) -> bool {
        self.path.ends_with("/tests.rs") || self.path.ends_with("_tests.rs")
    }

    /// Every path in its code, absolute where it is ours: `crate::serve::dto`, `std::fs::File`.
    pub fn paths(&self) -> Vec<Vec<String>> {
        if self.is_test() {
            return Vec::new();
        }
        let tokens = without_tests(tokens(&code(&self.text)));
        let mut found = Vec::new();
        let mut at = 0;
        while at < tokens.len() {
            if let Some(end) = visibility(&tokens[at..]) {
                at += end;
                continue;
            }
            // `use<'a>` names what a returned type captures.
            if tokens[at] == "use" && tokens.get(at + 1).is_some_and(|t| t != "<") {
                at = use_tree(&tokens, at + 1, &[], &mut found);
            } else if is_name(&tokens[at]) {
                let mut path = vec![tokens[at].clone()];
                while tokens.get(at + 1).is_some_and(|t| t == "::")
                    && tokens.get(at + 2).is_some_and(|t| is_name(t))
                {
                    path.push(tokens[at + 2].clone());
                    at += 2;
                }
                found.push(path);
                at += 1;
            } else {
                at += 1;
            }
        }
        found.into_iter().map(|path| self.absolute(path)).collect()
    }

    fn absolute(&self, path: Vec<String>) -> Vec<String> {
        let mut base = self.module();
        let own = match path[0].as_str() {
            "crate" => return path,
            "stictiond" => return [vec!["crate".to_string()], path[1..].to_vec()].concat(),
            "self" => 1,
            "super" => path.iter().take_while(|step| *step == "super").count(),
            _ => return path,
        };
        if path[0] == "super" {
            base.truncate(base.len().saturating_sub(own));
        }
        [vec!["crate".to_string()], base, path[own..].to_vec()].concat()
    }
}

fn is_name(token: &str) -> bool {
    token.starts_with(|c: char| c.is_alphabetic() || c == '_')
}

/// The length of `pub(super)`, `pub(in crate::app)` and the like, which say who may import and import nothing.
fn visibility(tokens: &[String]) -> Option<usize> {
    let next = |at: usize| tokens.get(at).map(String::as_str);
    if next(0) != Some("pub") || next(1) != Some("(") {
        return None;
    }
    match next(2)? {
        "in" => Some(tokens.iter().position(|token| token == ")")? + 1),
        "crate" | "self" | "super" if next(3) == Some(")") => Some(4),
        _ => None,
    }
}

/// Reads one `use` tree that begins at `at`, below `prefix`; returns where it ends.
fn use_tree(tokens: &[String], mut at: usize, prefix: &[String], found: &mut Vec<Vec<String>>) -> usize {
    let mut path = prefix.to_vec();
    while let Some(token) = tokens.get(at) {
        match token.as_str() {
            "::" => at += 1,
            "as" => at += 2,
            "{" => {
                at += 1;
                while tokens.get(at).is_some_and(|t| t != "}") {
                    at = use_tree(tokens, at, &path, found);
                    if tokens.get(at).is_some_and(|t| t == ",") {
                        at += 1;
                    }
                }
                return at + 1;
            }
            "," | "}" | ";" => break,
            "self" if !path.is_empty() => at += 1,
            name => {
                path.push(name.to_string());
                at += 1;
            }
        }
    }
    if !path.is_empty() {
        found.push(path);
    }
    at
}

/// The text without comments and without what is inside quotes.
fn code(text: &str) -> String {
    let chars: Vec<char> = text.chars().collect();
    let (mut out, mut at) = (String::new(), 0);
    let is = |at: usize, c: char| chars.get(at) == Some(&c);
    while at < chars.len() {
        let raw =
            chars[at] == 'r' && (is(at + 1, '"') || is(at + 1, '#') && (is(at + 2, '"') || is(at + 2, '#')));
        if is(at, '/') && is(at + 1, '/') {
            while at < chars.len() && chars[at] != '\n' {
                at += 1;
            }
        } else if is(at, '/') && is(at + 1, '*') {
            let mut depth = 0;
            loop {
                if is(at, '/') && is(at + 1, '*') {
                    (depth, at) = (depth + 1, at + 2);
                } else if is(at, '*') && is(at + 1, '/') {
                    (depth, at) = (depth - 1, at + 2);
                } else {
                    at += 1;
                }
                if depth == 0 || at >= chars.len() {
                    break;
                }
            }
        } else if raw && !out.ends_with(|c: char| c.is_alphanumeric() || c == '_') {
            let hashes = chars[at + 1..].iter().take_while(|c| **c == '#').count();
            at += hashes + 2;
            let ends = |at: usize| is(at, '"') && (1..=hashes).all(|h| is(at + h, '#'));
            while at < chars.len() && !ends(at) {
                at += 1;
            }
            at += hashes + 1;
            out.push('_');
        } else if chars[at] == '"' {
            at += 1;
            while at < chars.len() && chars[at] != '"' {
                at += if chars[at] == '\\' { 2 } else { 1 };
            }
            at += 1;
            out.push('_');
        } else if chars[at] == '\'' && is(at + 1, '\\') {
            at += 3;
            while at < chars.len() && chars[at] != '\'' {
                at += 1;
            }
            at += 1;
        } else if chars[at] == '\'' && is(at + 2, '\'') {
            at += 3;
        } else {
            out.push(chars[at]);
            at += 1;
        }
    }
    out
}

/// Names, `::` and single signs.
fn tokens(code: &str) -> Vec<String> {
    let mut out: Vec<String> = Vec::new();
    let mut rest = code;
    while let Some(c) = rest.chars().next() {
        let end = rest.find(|c: char| !(c.is_alphanumeric() || c == '_')).unwrap_or(rest.len());
        let length = if end > 0 {
            end
        } else if rest.starts_with("::") {
            2
        } else {
            c.len_utf8()
        };
        if !c.is_whitespace() {
            out.push(rest[..length].to_string());
        }
        rest = &rest[length..];
    }
    out
}

/// What is left when everything behind `#[cfg(test)]` is cut out.
fn without_tests(tokens: Vec<String>) -> Vec<String> {
    let mark = ["#", "[", "cfg", "(", "test", ")", "]"];
    let (mut out, mut at) = (Vec::new(), 0);
    while at < tokens.len() {
        if tokens[at..].iter().map(String::as_str).take(mark.len()).eq(mark) {
            let mut depth = 0;
            at += mark.len();
            while at < tokens.len() {
                match tokens[at].as_str() {
                    "{" => depth += 1,
                    "}" => depth -= 1,
                    _ => {}
                }
                let ended = depth == 0 && (tokens[at] == "}" || tokens[at] == ";");
                at += 1;
                if ended {
                    break;
                }
            }
        } else {
            out.push(tokens[at].clone());
            at += 1;
        }
    }
    out
}
