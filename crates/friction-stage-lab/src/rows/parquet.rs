//! The rows of a selection as Parquet, for whoever reads many of them.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use ::parquet::basic::Compression;
use ::parquet::data_type::{BoolType, ByteArray, ByteArrayType, DoubleType, Int64Type};
use ::parquet::errors::ParquetError;
use ::parquet::file::properties::WriterProperties;
use ::parquet::file::writer::SerializedFileWriter;
use ::parquet::schema::parser::parse_message_type;

use super::{RowsError, VariantRows};
use crate::variant::{VariantResult, variant_seed};
use friction_stage_core::model::Guide;

/// Rows per group of the Parquet file: what is in memory at once.
const GROUP: usize = 65_536;
/// Columns of the Parquet file, as those of the CSV.
const SCHEMA: &str = "message variants {
    REQUIRED BYTE_ARRAY guide (UTF8);
    REQUIRED INT64 variant (INTEGER(64,false));
    REQUIRED INT64 seed (INTEGER(64,false));
    REQUIRED DOUBLE peak_error_m;
    OPTIONAL DOUBLE settling_time_s;
    REQUIRED BOOLEAN saturated;
    REQUIRED DOUBLE stiffness;
    REQUIRED DOUBLE bristle_damping;
    REQUIRED DOUBLE viscous_friction;
    REQUIRED DOUBLE coulomb_force;
    REQUIRED DOUBLE static_force;
    REQUIRED DOUBLE stribeck_velocity;
}";

impl VariantRows {
    /// Writes the rows once more as Parquet, in groups, uncompressed columns of plain types that
    /// every reader takes.
    pub fn write_parquet(&self, path: &Path) -> Result<(), RowsError> {
        let failed = |source| RowsError::Parquet { path: path.to_owned(), source };
        let schema = Arc::new(parse_message_type(SCHEMA).map_err(failed)?);
        let properties = WriterProperties::builder()
            .set_compression(Compression::UNCOMPRESSED)
            .set_created_by(format!("friction-stage {}", env!("CARGO_PKG_VERSION")))
            .build();
        let file = File::create(path).map_err(RowsError::io("write", path))?;
        let mut writer =
            SerializedFileWriter::new(file, schema, Arc::new(properties)).map_err(failed)?;
        let mut group: Vec<(usize, VariantResult)> = Vec::new();
        self.read(&mut |index, result| {
            group.push((index, result));
            if group.len() == GROUP {
                self.write_group(&mut writer, &group).map_err(failed)?;
                group.clear();
            }
            Ok(())
        })?;
        if !group.is_empty() {
            self.write_group(&mut writer, &group).map_err(failed)?;
        }
        writer.close().map_err(failed)?;
        Ok(())
    }

    fn write_group(
        &self,
        writer: &mut SerializedFileWriter<File>,
        rows: &[(usize, VariantResult)],
    ) -> Result<(), ParquetError> {
        let plan = &self.sheet.plan;
        let name = |index: usize| plan.candidates[index].name.as_str();
        let numbers = |value: &dyn Fn(&VariantResult) -> f64| -> Vec<f64> {
            rows.iter().map(|(_, result)| value(result)).collect()
        };
        let of_guide = |value: fn(&Guide) -> f64| numbers(&|result| value(&result.guide));
        // Unsigned numbers keep their bits in the signed physical type, as the format has it.
        let words = |value: &dyn Fn(usize, u64) -> u64| -> Vec<i64> {
            rows.iter().map(|(index, result)| value(*index, result.variant) as i64).collect()
        };
        let mut group = writer.next_row_group()?;
        let mut column = 0;
        while let Some(mut target) = group.next_column()? {
            match column {
                0 => {
                    let names: Vec<ByteArray> =
                        rows.iter().map(|(index, _)| ByteArray::from(name(*index))).collect();
                    target.typed::<ByteArrayType>().write_batch(&names, None, None)?;
                }
                1 => {
                    target.typed::<Int64Type>().write_batch(
                        &words(&|_, variant| variant),
                        None,
                        None,
                    )?;
                }
                2 => {
                    let seeds =
                        words(&|index, variant| variant_seed(plan.seed, name(index), variant));
                    target.typed::<Int64Type>().write_batch(&seeds, None, None)?;
                }
                4 => {
                    let settled: Vec<f64> =
                        rows.iter().filter_map(|(_, result)| result.settling_time).collect();
                    let defined: Vec<i16> = rows
                        .iter()
                        .map(|(_, result)| i16::from(result.settling_time.is_some()))
                        .collect();
                    target.typed::<DoubleType>().write_batch(&settled, Some(&defined), None)?;
                }
                5 => {
                    let saturated: Vec<bool> =
                        rows.iter().map(|(_, result)| result.saturated).collect();
                    target.typed::<BoolType>().write_batch(&saturated, None, None)?;
                }
                _ => {
                    let values = match column {
                        3 => numbers(&|result| result.peak_error),
                        6 => of_guide(|guide| guide.stiffness),
                        7 => of_guide(|guide| guide.bristle_damping),
                        8 => of_guide(|guide| guide.viscous_friction),
                        9 => of_guide(|guide| guide.coulomb_force),
                        10 => of_guide(|guide| guide.static_force),
                        _ => of_guide(|guide| guide.stribeck_velocity),
                    };
                    target.typed::<DoubleType>().write_batch(&values, None, None)?;
                }
            }
            target.close()?;
            column += 1;
        }
        group.close()?;
        Ok(())
    }
}
