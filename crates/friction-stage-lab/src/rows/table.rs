//! Any table as a file, CSV or Parquet by its name.

use std::collections::BTreeMap;
use std::path::Path;

use super::{Cell, Column, RowsError};

/// What a table is written as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TableFormat {
    /// Text with a header.
    Csv,
    /// Columns of plain types.
    Parquet,
}

impl TableFormat {
    /// The format that the name of a file asks for.
    pub fn of(path: &Path) -> Result<TableFormat, RowsError> {
        let extension = path.extension().map(|extension| extension.to_ascii_lowercase());
        match extension.as_ref().and_then(|extension| extension.to_str()) {
            Some("csv") => Ok(TableFormat::Csv),
            Some("parquet") if cfg!(feature = "parquet") => Ok(TableFormat::Parquet),
            _ => Err(RowsError::Format { path: path.to_owned() }),
        }
    }
}

/// Writes a table in the format of its file's name. A Parquet file keeps what is said about it.
pub fn write_table(
    path: &Path,
    about: &BTreeMap<String, String>,
    columns: Vec<Column>,
    rows: impl Iterator<Item = Vec<Cell>>,
) -> Result<(), RowsError> {
    match TableFormat::of(path)? {
        TableFormat::Csv => {
            let failed = |source| RowsError::Csv { path: path.to_owned(), source };
            let mut writer =
                csv::WriterBuilder::new().has_headers(false).from_path(path).map_err(failed)?;
            writer.write_record(columns.iter().map(|column| &column.name)).map_err(failed)?;
            for row in rows {
                writer.serialize(row).map_err(failed)?;
            }
            writer.flush().map_err(RowsError::io("write", path))
        }
        #[cfg(feature = "parquet")]
        TableFormat::Parquet => {
            let failed = |source| RowsError::Parquet { path: path.to_owned(), source };
            let mut table = super::ParquetTable::create(path, "samples", about, columns)?;
            for row in rows {
                table.push(row).map_err(failed)?;
            }
            table.finish().map_err(failed)
        }
        #[cfg(not(feature = "parquet"))]
        TableFormat::Parquet => {
            let _ = about;
            Err(RowsError::Format { path: path.to_owned() })
        }
    }
}
