//! Parquet: a row a record, CSI as fixed-size lists, units in the schema's metadata.

use super::{Export, ExportError, PIECE};
use crate::table::NO_TIME;
use arrow_array::types::{Float32Type, Int8Type};
use arrow_array::{
    ArrayRef, BooleanArray, FixedSizeListArray, Float64Array, Int8Array, Int64Array, PrimitiveArray, RecordBatch,
    StringArray, TimestampMicrosecondArray, UInt8Array, UInt16Array, UInt32Array,
};
use arrow_schema::{DataType, Field, Schema};
use csi5300::signal::csi::{scale_factor, total_rss_dbm};
use driver_iface::Mac;
use driver_iface::bfee::{Antenna, NOISE_UNKNOWN_DBM, SUBCARRIERS};
use num_complex::Complex32;
use parquet::arrow::ArrowWriter;
use parquet::arrow::arrow_writer::ArrowWriterOptions;
use parquet::basic::Compression;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use std::collections::HashMap;
use std::fs::File;
use std::path::Path;
use std::sync::Arc;

/// Records of a row group.
const GROUP: usize = 16_384;

/// A column of a batch.
type Column = (Field, ArrayRef);

/// Writes all records.
pub fn write(export: &Export<'_>, path: &Path) -> Result<(), ExportError> {
    let file = path.display().to_string();
    let format =
        |source: parquet::errors::ParquetError| ExportError::Format { file: file.clone(), source: source.into() };
    let arrow = |source: arrow_schema::ArrowError| ExportError::Format { file: file.clone(), source: source.into() };
    let out = File::create(path).map_err(|source| ExportError::Io { file: file.clone(), source })?;
    let properties = WriterProperties::builder()
        .set_compression(Compression::SNAPPY)
        .set_max_row_group_row_count(Some(GROUP))
        .set_created_by("csi5300".into())
        // Arrow's readers find the facts in the schema, others here.
        .set_key_value_metadata(Some(facts(export).into_iter().map(|(name, fact)| KeyValue::new(name, fact)).collect()))
        .build();
    let none = batch(export, 0, &[])?;
    let options = ArrowWriterOptions::new().with_properties(properties);
    let mut writer = ArrowWriter::try_new_with_options(out, schema(export, &none), options).map_err(format)?;
    for (piece, csi) in export.csi().enumerate() {
        let columns = batch(export, piece * PIECE, &csi)?;
        let schema = schema(export, &columns);
        let arrays = columns.into_iter().map(|(_, array)| array).collect();
        writer.write(&RecordBatch::try_new(schema, arrays).map_err(arrow)?).map_err(format)?;
    }
    writer.close().map(|_| ()).map_err(format)
}

/// What holds for the whole file.
fn facts(export: &Export<'_>) -> HashMap<String, String> {
    let letters: String = export.antennas.iter().map(Antenna::to_string).collect();
    let subcarriers = export.subcarriers().map(|indices| indices.map(|index| index.to_string()).join(","));
    let shape = format!("{},{},{SUBCARRIERS}", export.antennas.len(), export.streams);
    let facts = [
        ("csi5300.antennas", letters),
        ("csi5300.csi_shape", shape),
        ("csi5300.csi_order", "antenna,stream,subcarrier; subcarrier fastest".into()),
        ("csi5300.scaled", export.form.scaled.to_string()),
        ("csi5300.subcarriers", subcarriers.unwrap_or_else(|| "mixed widths".into())),
    ];
    facts.into_iter().map(|(name, fact)| (name.to_owned(), fact)).collect()
}

/// The schema of the columns.
fn schema(export: &Export<'_>, columns: &[Column]) -> Arc<Schema> {
    let fields: Vec<Field> = columns.iter().map(|(field, _)| field.clone()).collect();
    Arc::new(Schema::new_with_metadata(fields, facts(export)))
}

fn column(name: &str, unit: &str, nullable: bool, array: ArrayRef) -> Column {
    let metadata = HashMap::from([("unit".to_owned(), unit.to_owned())]);
    (Field::new(name, array.data_type().clone(), nullable).with_metadata(metadata), array)
}

/// The records from `first` on whose CSI is given.
fn batch(export: &Export<'_>, first: usize, csi: &[Complex32]) -> Result<Vec<Column>, ExportError> {
    let size = export.antennas.len() * export.streams * SUBCARRIERS;
    let (all, n) = (export.columns, csi.len() / size.max(1));
    let part = first..first + n;
    macro_rules! of {
        ($name:ident, $width:literal) => {
            all.$name.get($width * part.start..$width * part.end).unwrap_or_default()
        };
    }
    let rssi = |port: usize| -> ArrayRef {
        Arc::new(UInt8Array::from_iter_values(of!(rssi, 3).iter().skip(port).step_by(3).copied()))
    };
    let noise = of!(noise_dbm, 1).iter().map(|dbm| Some(*dbm).filter(|dbm| *dbm != NOISE_UNKNOWN_DBM));
    let host = of!(host_us, 1).iter().map(|us| Some(*us).filter(|us| *us != NO_TIME));
    let frame = of!(frame, 1).iter().map(|number| u32::try_from(*number).ok());
    let mac = |octets: &[u8]| {
        <[u8; 6]>::try_from(octets).ok().map(Mac).filter(|mac| !mac.is_zero()).map(|mac| mac.to_string())
    };
    let known: Vec<bool> = export.antennas_known().skip(part.start).take(n).collect();
    let figure = |values: Vec<f64>| -> ArrayRef {
        Arc::new(Float64Array::from_iter(values.into_iter().map(|value| Some(value).filter(|value| value.is_finite()))))
    };
    let mut columns = vec![
        column(
            "time_us",
            "microseconds, card's clock, unwrapped",
            false,
            Arc::new(Int64Array::from_iter_values(of!(time_us, 1).iter().copied())),
        ),
        column("host_time", "UTC", true, Arc::new(TimestampMicrosecondArray::from_iter(host).with_timezone("UTC"))),
        column("mac", "", true, Arc::new(StringArray::from_iter(of!(mac, 6).chunks(6).map(mac)))),
        column("frame_count", "", true, Arc::new(UInt32Array::from_iter(frame))),
        column("rssi_a", "dB above the card's reference, 0: nothing heard", false, rssi(0)),
        column("rssi_b", "dB above the card's reference, 0: nothing heard", false, rssi(1)),
        column("rssi_c", "dB above the card's reference, 0: nothing heard", false, rssi(2)),
        column("noise_dbm", "dBm", true, Arc::new(Int8Array::from_iter(noise))),
        column("agc", "dB", false, Arc::new(UInt8Array::from_iter_values(of!(agc, 1).iter().copied()))),
        column("antenna_sel", "", false, Arc::new(UInt8Array::from_iter_values(of!(antenna_sel, 1).iter().copied()))),
        column("antennas_known", "", false, Arc::new(BooleanArray::from(known))),
        column("rate_n_flags", "", false, Arc::new(UInt16Array::from_iter_values(of!(rate, 1).iter().copied()))),
        column("n_rx", "", false, Arc::new(UInt8Array::from_iter_values(of!(n_rx, 1).iter().copied()))),
        column("n_tx", "", false, Arc::new(UInt8Array::from_iter_values(of!(n_tx, 1).iter().copied()))),
        column("bfee_count", "", false, Arc::new(UInt16Array::from_iter_values(of!(bfee_count, 1).iter().copied()))),
        column(
            "timestamp_low",
            "microseconds, wraps",
            false,
            Arc::new(UInt32Array::from_iter_values(of!(timestamp_low, 1).iter().copied())),
        ),
        column("offset", "bytes", false, Arc::new(Int64Array::from_iter_values(of!(offset, 1).iter().copied()))),
        column(
            "total_rss_dbm",
            "dBm",
            true,
            figure(export.figure(first, |bfee| total_rss_dbm(bfee).ok()).take(n).collect()),
        ),
        column(
            "scale",
            "sqrt(SNR) per unit",
            true,
            figure(export.figure(first, |bfee| scale_factor(bfee).ok()).take(n).collect()),
        ),
    ];
    columns.push(lists(export, "csi_re", csi, size, |h| h.re)?);
    columns.push(lists(export, "csi_im", csi, size, |h| h.im)?);
    Ok(columns)
}

/// One part of the CSI: the card's integers as such, scaled CSI as floats; null where a record has none.
fn lists(
    export: &Export<'_>,
    name: &str,
    csi: &[Complex32],
    size: usize,
    part: fn(&Complex32) -> f32,
) -> Result<Column, ExportError> {
    let integers = !export.form.scaled && !export.form.without_spatial_mapping;
    let there = csi.iter().map(|h| Some(part(h)).filter(|value| !value.is_nan()));
    let (values, kind, unit): (ArrayRef, _, _) = if integers {
        // The card's integers are -128 to 127.
        let bytes: PrimitiveArray<Int8Type> = there.map(|value| value.map(|value| value as i8)).collect();
        (Arc::new(bytes), DataType::Int8, "card's integers")
    } else {
        let floats: PrimitiveArray<Float32Type> = there.collect();
        (Arc::new(floats), DataType::Float32, if export.form.scaled { "sqrt(SNR)" } else { "card's integers" })
    };
    let item = Arc::new(Field::new("item", kind, true));
    let width = i32::try_from(size).unwrap_or(i32::MAX);
    let list = FixedSizeListArray::try_new(item, width, values, None);
    let list = list.map_err(|source| ExportError::Format { file: name.to_owned(), source: source.into() })?;
    Ok(column(name, unit, false, Arc::new(list)))
}
