//! The rows of a plan as Parquet, for whoever reads many of them.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use ::parquet::basic::Compression;
use ::parquet::basic::{ConvertedType, LogicalType, Repetition, Type as PhysicalType};
use ::parquet::data_type::{BoolType, ByteArray, ByteArrayType, DoubleType, Int64Type};
use ::parquet::errors::ParquetError;
use ::parquet::file::metadata::KeyValue;
use ::parquet::file::properties::WriterProperties;
use ::parquet::file::writer::SerializedFileWriter;
use ::parquet::schema::types::{Type, TypePtr};

use super::{Cell, Column, ColumnKind, NumberedPlan, Rows, RowsError};

/// Rows per group of the Parquet file: what is in memory at once.
const GROUP: usize = 65_536;

/// Writes rows as Parquet, in groups, uncompressed columns of plain types that every reader takes.
pub struct ParquetTable {
    columns: Vec<Column>,
    writer: SerializedFileWriter<File>,
    group: Vec<Vec<Cell>>,
}

impl ParquetTable {
    /// A file of these columns; its metadata hold what is said about it.
    pub fn create(
        path: &Path,
        name: &str,
        about: &BTreeMap<String, String>,
        columns: Vec<Column>,
    ) -> Result<ParquetTable, RowsError> {
        let failed = |source| RowsError::Parquet { path: path.to_owned(), source };
        let fields = columns.iter().map(field).collect::<Result<_, _>>().map_err(failed)?;
        let schema = Type::group_type_builder(name).with_fields(fields).build().map_err(failed)?;
        let properties = WriterProperties::builder()
            .set_compression(Compression::UNCOMPRESSED)
            .set_created_by(format!("friction-stage {}", env!("CARGO_PKG_VERSION")))
            .set_key_value_metadata((!about.is_empty()).then(|| {
                about.iter().map(|(key, value)| KeyValue::new(key.clone(), value.clone())).collect()
            }))
            .build();
        let file = File::create(path).map_err(RowsError::io("write", path))?;
        let writer = SerializedFileWriter::new(file, Arc::new(schema), Arc::new(properties))
            .map_err(failed)?;
        Ok(ParquetTable { columns, writer, group: Vec::new() })
    }

    /// Adds a row.
    pub fn push(&mut self, row: Vec<Cell>) -> Result<(), ParquetError> {
        self.group.push(row);
        if self.group.len() == GROUP { self.write_group() } else { Ok(()) }
    }

    /// Writes what is left and the end of the file.
    pub fn finish(mut self) -> Result<(), ParquetError> {
        if !self.group.is_empty() {
            self.write_group()?;
        }
        self.writer.close()?;
        Ok(())
    }

    fn write_group(&mut self) -> Result<(), ParquetError> {
        let rows = std::mem::take(&mut self.group);
        let mut group = self.writer.next_row_group()?;
        let mut index = 0;
        while let Some(mut target) = group.next_column()? {
            let cells = || rows.iter().filter_map(|row| row.get(index));
            match self.columns[index].kind {
                ColumnKind::Text => {
                    let texts: Vec<ByteArray> =
                        cells().map(|cell| ByteArray::from(cell.text())).collect();
                    target.typed::<ByteArrayType>().write_batch(&texts, None, None)?;
                }
                ColumnKind::Count => {
                    // Unsigned numbers keep their bits in the signed physical type, as the format
                    // has it.
                    let counts: Vec<i64> = cells().map(|cell| cell.count() as i64).collect();
                    target.typed::<Int64Type>().write_batch(&counts, None, None)?;
                }
                ColumnKind::Number => {
                    let numbers: Vec<f64> =
                        cells().map(|cell| cell.number().unwrap_or(f64::NAN)).collect();
                    target.typed::<DoubleType>().write_batch(&numbers, None, None)?;
                }
                ColumnKind::Optional => {
                    let defined: Vec<i16> =
                        cells().map(|cell| i16::from(cell.number().is_some())).collect();
                    let numbers: Vec<f64> = cells().filter_map(Cell::number).collect();
                    target.typed::<DoubleType>().write_batch(&numbers, Some(&defined), None)?;
                }
                ColumnKind::Flag => {
                    let flags: Vec<bool> = cells().map(Cell::flag).collect();
                    target.typed::<BoolType>().write_batch(&flags, None, None)?;
                }
            }
            target.close()?;
            index += 1;
        }
        group.close()?;
        Ok(())
    }
}

/// The column in the schema of the file.
fn field(column: &Column) -> Result<TypePtr, ParquetError> {
    let (physical, logical) = match column.kind {
        ColumnKind::Text => (PhysicalType::BYTE_ARRAY, Some(LogicalType::String)),
        ColumnKind::Count => (PhysicalType::INT64, Some(LogicalType::integer(64, false))),
        ColumnKind::Number | ColumnKind::Optional => (PhysicalType::DOUBLE, None),
        ColumnKind::Flag => (PhysicalType::BOOLEAN, None),
    };
    let repetition = match column.kind {
        ColumnKind::Optional => Repetition::OPTIONAL,
        _ => Repetition::REQUIRED,
    };
    let field = Type::primitive_type_builder(&column.name, physical)
        .with_repetition(repetition)
        .with_converted_type(ConvertedType::NONE)
        .with_logical_type(logical)
        .build()?;
    Ok(Arc::new(field))
}

impl<P: NumberedPlan> Rows<P> {
    /// Writes the rows once more as Parquet.
    pub fn write_parquet(&self, path: &Path) -> Result<(), RowsError> {
        let failed = |source| RowsError::Parquet { path: path.to_owned(), source };
        let plan = &self.sheet().plan;
        let mut table = ParquetTable::create(path, P::ROWS, &BTreeMap::new(), plan.columns())?;
        self.read(&mut |job, outcome| table.push(plan.row(job, &outcome)).map_err(failed))?;
        table.finish().map_err(failed)
    }
}
