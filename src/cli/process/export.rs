//! The arrays of a recording in one NumPy archive, for those who like to carry one file.
//!
//! In: a folder with `energyscape.npy`, `directions_deg.npy` and `ranges_m.npy`, and the meta data. Out: `energyscape.npz` with
//! arrays of these names, byte for byte, and `meta`, a text of JSON; the three files are gone then. Axes travel with the image.

use super::super::output::NewFile;
use super::super::{Failure, exit};
use serde_json::Value;
use std::fs::File;
use std::io::{BufReader, Write};
use std::path::{Path, PathBuf};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

const ARRAYS: [&str; 3] = ["energyscape", "directions_deg", "ranges_m"];

/// Puts the arrays together; gives the archive's path.
///
/// # Errors
/// Exit 73, 74 or 77.
pub fn into_archive(folder: &Path, meta: &Value) -> Result<PathBuf, Failure> {
    let path = folder.join("energyscape.npz");
    let failed = |error: &dyn std::fmt::Display| Failure::new(exit::IO, format!("{}: {error}", path.display()));
    let mut file = NewFile::create(&path)?;
    {
        // A writer that seeks would begin at the end of what is buffered; this one only ever goes on.
        let mut archive = ZipWriter::new_stream(Onward(&mut file));
        // Stored: numbers of sound do not compress, and whoever reads maps them.
        let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored).large_file(true);
        for name in ARRAYS {
            archive.start_file(format!("{name}.npy"), options).map_err(|error| failed(&error))?;
            let mut array = BufReader::new(File::open(folder.join(format!("{name}.npy")))?);
            std::io::copy(&mut array, &mut archive).map_err(|error| failed(&error))?;
        }
        archive.start_file("meta.npy", options).map_err(|error| failed(&error))?;
        archive.write_all(&text_array(&meta.to_string())).map_err(|error| failed(&error))?;
        archive.finish().map_err(|error| failed(&error))?;
    }
    file.finish()?;
    for name in ARRAYS {
        std::fs::remove_file(folder.join(format!("{name}.npy"))).map_err(|error| failed(&error))?;
    }
    Ok(path)
}

/// Hides from the archive's writer that a file can be sought in.
struct Onward<'a>(&'a mut NewFile);

impl Write for Onward<'_> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.0.flush()
    }
}

/// A `.npy` of one text, as NumPy writes `numpy.array("text")`: UTF-32, without a dimension.
fn text_array(text: &str) -> Vec<u8> {
    let dict = format!("{{'descr': '<U{}', 'fortran_order': False, 'shape': (), }}", text.chars().count());
    // Magic, version and length are ten bytes; the header ends with a line's end at a multiple of 64.
    let length = (10 + dict.len() + 1).next_multiple_of(64) - 10;
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((length as u16).to_le_bytes());
    bytes.extend(format!("{dict:width$}\n", width = length - 1).bytes());
    bytes.extend(text.chars().flat_map(|character| (character as u32).to_le_bytes()));
    bytes
}
