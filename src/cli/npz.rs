//! NPZ files, as NumPy reads them.

use npyz::npz::NpzWriter;
use npyz::{AutoSerialize, WriterBuilder};
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

/// An NPZ file being written.
pub struct Npz {
    writer: NpzWriter<BufWriter<File>>,
    name: String,
}

impl Npz {
    /// Creates (or replaces) the file.
    pub fn create(path: &Path) -> Result<Self, String> {
        let name = path.display().to_string();
        let file = File::create(path).map_err(|error| format!("cannot write {name}: {error}"))?;
        Ok(Self { writer: NpzWriter::new(BufWriter::new(file)), name })
    }

    /// Adds an array of the given shape, last index fastest.
    pub fn array<T: AutoSerialize>(
        &mut self,
        name: &str,
        shape: &[u64],
        mut values: impl Iterator<Item = T>,
    ) -> Result<(), String> {
        self.array_in(name, shape, |push| values.try_for_each(push))
    }

    /// Adds an array whose values `fill` pushes one by one.
    pub fn array_in<T: AutoSerialize>(
        &mut self,
        name: &str,
        shape: &[u64],
        fill: impl FnOnce(&mut dyn FnMut(T) -> Result<(), String>) -> Result<(), String>,
    ) -> Result<(), String> {
        let file = &self.name;
        let failed = |error: &dyn std::fmt::Display| format!("writing {name} to {file}: {error}");
        let entry = self.writer.array::<T>(name, Default::default()).map_err(|error| failed(&error))?;
        let mut array = entry.default_dtype().shape(shape).begin_nd().map_err(|error| failed(&error))?;
        fill(&mut |value| array.push(&value).map_err(|error| failed(&error)))?;
        array.finish().map_err(|error| failed(&error))
    }
}
