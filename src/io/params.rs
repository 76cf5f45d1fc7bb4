//! `[ipc]` of the configuration: where the shared-memory files live and what their names begin with.
//!
//! Only names and rules; the directory itself is made and checked by [`super::root`].

use crate::parameter::ParameterError;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Longest prefix: the transport's file names hold a prefix, a 40 character hash and a suffix.
const PREFIX_LEN_MAX: usize = 32;
/// Longest root path: the transport's paths end at 255 bytes, of which folder and file name take up to 120.
const ROOT_LEN_MAX: usize = 128;

/// `[ipc]`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct IpcParams {
    /// Directory of the transport's files, private to one user; see [`IpcParams::root_path`] for the default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub root: Option<PathBuf>,
    /// First characters of every name in that directory and in shared memory.
    pub prefix: String,
}

impl Default for IpcParams {
    fn default() -> Self {
        Self { root: None, prefix: "noctule_".to_owned() }
    }
}

impl IpcParams {
    /// Checks what can be checked without touching the file system.
    ///
    /// # Errors
    /// [`ParameterError`] for an empty, long or oddly spelt prefix, and for a root that is not absolute or too long.
    pub fn validate(&self) -> Result<(), ParameterError> {
        let spelt_well = self.prefix.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'-');
        if self.prefix.is_empty() || self.prefix.len() > PREFIX_LEN_MAX || !spelt_well {
            let allowed = format!("1 to {PREFIX_LEN_MAX} letters, digits, `_` or `-`");
            return Err(ParameterError::new("prefix", format!("{:?}", self.prefix), allowed));
        }
        let Some(root) = &self.root else { return Ok(()) };
        let text = root.to_str().unwrap_or("");
        if !root.is_absolute() || text.is_empty() || text.len() > ROOT_LEN_MAX {
            let allowed = format!("an absolute path of at most {ROOT_LEN_MAX} bytes, in UTF-8");
            return Err(ParameterError::new("root", root.display(), allowed));
        }
        Ok(())
    }

    /// The configured root, or the default one: `/run/noctule` for root, else `$XDG_RUNTIME_DIR/noctule`, else
    /// `/tmp/noctule-<uid>`.
    #[must_use]
    pub fn root_path(&self) -> PathBuf {
        self.root.clone().unwrap_or_else(|| {
            let runtime_dir = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from);
            default_root(rustix::process::geteuid().as_raw(), runtime_dir.as_deref())
        })
    }
}

/// The rule of [`IpcParams::root_path`]. A relative `$XDG_RUNTIME_DIR` is invalid by its own specification: ignored.
fn default_root(uid: u32, runtime_dir: Option<&Path>) -> PathBuf {
    match runtime_dir.filter(|dir| dir.is_absolute()) {
        _ if uid == 0 => PathBuf::from("/run/noctule"),
        Some(dir) => dir.join("noctule"),
        None => PathBuf::from(format!("/tmp/noctule-{uid}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_root_belongs_to_one_user() {
        let runtime = Path::new("/run/user/1000");
        assert_eq!(default_root(0, Some(runtime)), Path::new("/run/noctule"));
        assert_eq!(default_root(1000, Some(runtime)), Path::new("/run/user/1000/noctule"));
        assert_eq!(default_root(1000, None), Path::new("/tmp/noctule-1000"));
        assert_eq!(default_root(1000, Some(Path::new("here"))), Path::new("/tmp/noctule-1000"));
    }

    #[test]
    fn the_defaults_are_valid() {
        assert_eq!(IpcParams::default().validate(), Ok(()));
        assert_eq!(IpcParams::default().prefix, "noctule_");
    }

    #[test]
    fn a_prefix_that_could_leave_the_root_is_refused() {
        for prefix in ["", "a/b", "../", "a b", "ä", &"x".repeat(33)] {
            let params = IpcParams { prefix: prefix.to_owned(), ..IpcParams::default() };
            assert_eq!(params.validate().expect_err("refused").key, "prefix", "{prefix}");
        }
    }

    #[test]
    fn a_root_must_be_absolute_and_short_enough() {
        for root in ["ipc", "", &format!("/{}", "x".repeat(128))] {
            let params = IpcParams { root: Some(PathBuf::from(root)), ..IpcParams::default() };
            assert_eq!(params.validate().expect_err("refused").key, "root", "{root}");
        }
    }
}
