//! Writing results: NumPy arrays, progress, folders. Every file appears complete or not at all.

use super::{Failure, exit};
use crate::io::encode_png;
use crate::io::picture::Picture;
use indicatif::{ProgressBar, ProgressStyle};
use npyz::WriterBuilder as _;
use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Makes a folder and its parents.
///
/// # Errors
/// Exit 73, or 77 without permission.
pub fn make_folder(path: &Path) -> Result<(), Failure> {
    std::fs::create_dir_all(path).map_err(|error| cannot_create(path, &error))
}

/// The failure for a file or folder that cannot be made.
pub fn cannot_create(path: &Path, error: &std::io::Error) -> Failure {
    use std::io::ErrorKind::{
        AlreadyExists, IsADirectory, NotADirectory, PermissionDenied, ReadOnlyFilesystem, StorageFull,
    };
    let (code, why) = match error.kind() {
        PermissionDenied => {
            (exit::PERMISSION, "found no permission to write there, allowed: a folder of this user".to_owned())
        }
        StorageFull => (exit::IO, "the disk is full".to_owned()),
        ReadOnlyFilesystem => {
            (exit::CANNOT_CREATE, "found a read-only file system, allowed: one that can be written".to_owned())
        }
        AlreadyExists | NotADirectory => (
            exit::CANNOT_CREATE,
            "found a file where a folder is needed, allowed: a folder, or a name that is free".to_owned(),
        ),
        IsADirectory => (exit::CANNOT_CREATE, "found a folder where a file is needed".to_owned()),
        _ => (exit::CANNOT_CREATE, error.to_string()),
    };
    Failure::new(code, format!("{}: cannot create: {why}", path.display()))
}

/// A file under a temporary name beside its place, which takes its place when it is finished.
pub struct NewFile {
    path: PathBuf,
    partial: PathBuf,
    writer: BufWriter<File>,
    finished: bool,
}

impl NewFile {
    /// Starts a file.
    ///
    /// # Errors
    /// Exit 73, or 77 without permission.
    pub fn create(path: &Path) -> Result<Self, Failure> {
        let mut name = path.file_name().unwrap_or_default().to_owned();
        name.push(".partial");
        let partial = path.with_file_name(name);
        let file = File::create(&partial).map_err(|error| cannot_create(&partial, &error))?;
        Ok(Self { path: path.to_owned(), partial, writer: BufWriter::with_capacity(1 << 18, file), finished: false })
    }

    /// Writes what is buffered and puts the file in its place.
    ///
    /// # Errors
    /// Exit 74 when the disk is full or fails.
    pub fn finish(mut self) -> Result<(), Failure> {
        let io = |error: std::io::Error| Failure::new(exit::IO, format!("{}: {error}", self.path.display()));
        self.writer.flush().map_err(io)?;
        std::fs::rename(&self.partial, &self.path).map_err(io)?;
        self.finished = true;
        Ok(())
    }

    /// Writes over the first bytes of the file; later bytes go to its end as before.
    ///
    /// # Errors
    /// Exit 74 when the disk is full or fails.
    pub fn overwrite_start(&mut self, bytes: &[u8]) -> Result<(), Failure> {
        let written = (|| {
            self.writer.seek(SeekFrom::Start(0))?;
            self.writer.write_all(bytes)?;
            self.writer.seek(SeekFrom::End(0))
        })();
        written.map(|_| ()).map_err(|error| self.failure(&error))
    }

    /// The failure for bytes that could not be written.
    pub fn failure(&self, error: &std::io::Error) -> Failure {
        Failure::new(exit::IO, format!("{}: {error}", self.path.display()))
    }
}

impl Drop for NewFile {
    fn drop(&mut self) {
        if !self.finished {
            // Nothing else can be done about it here; the name says that it is incomplete.
            let _ = std::fs::remove_file(&self.partial);
        }
    }
}

impl Write for NewFile {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.writer.write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.writer.flush()
    }
}

/// Writes a whole array.
///
/// # Errors
/// Exit 73, 74 or 77.
pub fn write_npy<T: npyz::AutoSerialize + Copy>(path: &Path, shape: &[u64], values: &[T]) -> Result<(), Failure> {
    let mut file = NewFile::create(path)?;
    let written = (|| {
        let mut writer = npyz::WriteOptions::new().default_dtype().shape(shape).writer(&mut file).begin_nd()?;
        writer.extend(values.iter().copied())?;
        writer.finish()
    })();
    written.map_err(|error| file.failure(&error))?;
    file.finish()
}

/// Writes pretty JSON with a final newline.
///
/// # Errors
/// Exit 73, 74 or 77.
pub fn write_json(path: &Path, value: &serde_json::Value) -> Result<(), Failure> {
    let mut file = NewFile::create(path)?;
    let text = format!("{value:#}\n");
    file.write_all(text.as_bytes()).map_err(|error| file.failure(&error))?;
    file.finish()
}

/// Writes a picture as PNG.
///
/// # Errors
/// Exit 73, 74 or 77.
pub fn write_picture(path: &Path, picture: &Picture) -> Result<(), Failure> {
    let mut file = NewFile::create(path)?;
    encode_png(&mut file, picture).map_err(|error| file.failure(&error))?;
    file.finish()
}

/// Prints one line on standard output; a closed pipe is the reader's choice, not a failure.
///
/// # Errors
/// Exit 74 for anything but a closed pipe.
pub fn print_line(line: &str) -> Result<(), Failure> {
    is_printed(line).map(|_| ())
}

/// Prints one line on standard output; false when nobody reads any more.
///
/// # Errors
/// Exit 74 for anything but a closed pipe.
pub fn is_printed(line: &str) -> Result<bool, Failure> {
    match writeln!(std::io::stdout().lock(), "{line}") {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(false),
        Err(error) => Err(Failure::new(exit::IO, error)),
    }
}

/// A progress bar on a terminal, nothing elsewhere.
#[must_use]
pub fn progress(length: u64, what: &'static str) -> ProgressBar {
    let style = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len} {per_sec} {eta}");
    let bar = ProgressBar::new(length).with_message(what);
    match style {
        Ok(style) => bar.with_style(style),
        Err(_) => bar,
    }
}
