//! Who may come in, and by which way: what `[server]`, `[access]` and `[audit]` mean together.

use super::{Parts, Rules, Step};
use std::path::{Component, Path, PathBuf};

impl Rules<'_, '_, '_> {
    pub(super) fn door(&mut self, parts: &Parts) {
        let access = parts.access.as_ref().and_then(Option::as_ref);
        let audit = parts.audit.as_ref().and_then(Option::as_ref);
        self.section("access", access.map(|access| access.validate()));
        self.section("audit", audit.map(|audit| audit.validate()));
        // Of a section that could not be read nothing is known.
        let (Some(server), Some(_), Some(_)) = (&parts.server, &parts.access, &parts.audit) else { return };
        if let Err(error) = server.permits(server.listen, access.is_some()) {
            self.wrong(&path!["server", "listen"], format!("listen: {error}"));
        }
        if access.is_some() && audit.is_none() {
            let message = "[access] needs [audit], so that every change is put on record with who made it";
            self.wrong(&path!["access"], message.to_string());
        }
        let theirs = parts.writeback.as_ref().and_then(|writeback| writeback.audit_file.as_ref());
        if audit.zip(theirs).is_some_and(|(audit, theirs)| plain(&audit.file) == plain(theirs)) {
            let message = "file: is the log of [writeback] too; a log has one writer, give each its own";
            self.wrong(&path!["audit", "file"], message.to_string());
        }
        let logs = [("audit", "file", audit.map(|audit| &audit.file)), ("writeback", "audit_file", theirs)];
        for (section, key, file) in logs {
            let is_access = |file: &PathBuf| access.is_some_and(|access| plain(&access.file) == plain(file));
            self.unless(!file.is_some_and(is_access), &path![section, key], || {
                format!("{key}: is the file of [access] too, which holds the users: give the log another")
            });
            self.unless(file.is_none_or(|file| file != Path::new("/dev/null")), &path![section, key], || {
                format!("{key}: /dev/null keeps nothing: name a file")
            });
        }
    }
}

/// A path without the steps that lead nowhere: `./a.json` is `a.json`.
fn plain(path: &Path) -> PathBuf {
    path.components().filter(|step| *step != Component::CurDir).collect()
}
