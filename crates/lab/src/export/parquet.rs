//! Parquet: one row per record, CSI as fixed-size lists, units in the schema's metadata.

use super::{Export, Figures, Walk};
use crate::Failure;
use crate::table::{NO_TIME, Order};
use arrow_array::types::{ArrowPrimitiveType, Float32Type, Int8Type, Int64Type, UInt8Type, UInt16Type, UInt32Type};
use arrow_array::{
    ArrayRef, BooleanArray, FixedSizeListArray, Float64Array, Int8Array, PrimitiveArray, RecordBatch, StringArray,
    TimestampMicrosecondArray, UInt32Array,
};
use arrow_schema::{DataType, Field, Schema};
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
use std::io;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

/// Records of a row group.
const GROUP: usize = 16_384;

/// A column of a batch.
type Column = (Field, ArrayRef);

/// Writes all records.
pub fn write(export: &Export<'_>, path: &Path) -> Result<Figures, Failure> {
    let out = File::create(path)?;
    let properties = WriterProperties::builder()
        .set_compression(Compression::SNAPPY)
        .set_max_row_group_row_count(Some(GROUP))
        .set_created_by("csi5300".into())
        // Arrow's readers find the metadata in the schema, others here.
        .set_key_value_metadata(Some(facts(export).into_iter().map(|(name, fact)| KeyValue::new(name, fact)).collect()))
        .build();
    let none = batch(export, &Figures::default(), 0, &[])?;
    let options = ArrowWriterOptions::new().with_properties(properties);
    let mut writer =
        ArrowWriter::try_new_with_options(out, schema(export, &none), options).map_err(io::Error::other)?;
    let (mut walk, mut csi) = (Walk::new(export, Order::SubcarriersLast)?, Vec::new());
    while let Some(first) = walk.next(&mut csi) {
        let columns = batch(export, &walk.figures, first, &csi)?;
        let schema = schema(export, &columns);
        let arrays = columns.into_iter().map(|(_, array)| array).collect();
        writer.write(&RecordBatch::try_new(schema, arrays).map_err(io::Error::other)?).map_err(io::Error::other)?;
    }
    let figures = walk.finish()?;
    writer.close().map_err(io::Error::other)?;
    Ok(figures)
}

/// Metadata of the whole file.
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

/// A column of numbers that every record has.
fn numbers<T: ArrowPrimitiveType>(name: &str, unit: &str, values: impl Iterator<Item = T::Native>) -> Column {
    column(name, unit, false, Arc::new(PrimitiveArray::<T>::from_iter_values(values)))
}

/// The part of a column with `width` values per record.
fn of<T: Copy>(values: &[T], part: &Range<usize>, width: usize) -> impl Iterator<Item = T> {
    values.get(width * part.start..width * part.end).unwrap_or_default().iter().copied()
}

/// The records from `first` on, as many as there is CSI.
fn batch(export: &Export<'_>, figures: &Figures, first: usize, csi: &[Complex32]) -> io::Result<Vec<Column>> {
    const RSSI: &str = "dB above the card's reference, 0: nothing heard";
    let size = export.antennas.len() * export.streams * SUBCARRIERS;
    let (all, part) = (export.columns, &(first..first + csi.len() / size.max(1)));
    let mut columns =
        vec![numbers::<Int64Type>("time_us", "microseconds, card's clock, unwrapped", of(&all.time_us, part, 1))];
    columns.extend(maybe(export, figures, part));
    for (port, name) in ["rssi_a", "rssi_b", "rssi_c"].into_iter().enumerate() {
        columns.push(numbers::<UInt8Type>(name, RSSI, of(&all.rssi, part, 3).skip(port).step_by(3)));
    }
    let known: Vec<bool> = export.antennas_known().skip(part.start).take(part.len()).collect();
    columns.extend([
        numbers::<UInt8Type>("agc", "dB", of(&all.agc, part, 1)),
        numbers::<UInt8Type>("antenna_sel", "", of(&all.antenna_sel, part, 1)),
        column("antennas_known", "", false, Arc::new(BooleanArray::from(known))),
        numbers::<UInt16Type>("rate_n_flags", "", of(&all.rate, part, 1)),
        numbers::<UInt8Type>("n_rx", "", of(&all.n_rx, part, 1)),
        numbers::<UInt8Type>("n_tx", "", of(&all.n_tx, part, 1)),
        numbers::<UInt16Type>("bfee_count", "", of(&all.bfee_count, part, 1)),
        numbers::<UInt32Type>("timestamp_low", "microseconds, wraps", of(&all.timestamp_low, part, 1)),
        numbers::<Int64Type>("offset", "bytes", of(&all.offset, part, 1)),
        lists(export, "csi_re", csi, size, |h| h.re)?,
        lists(export, "csi_im", csi, size, |h| h.im)?,
    ]);
    Ok(columns)
}

/// The columns that may be null.
fn maybe(export: &Export<'_>, figures: &Figures, part: &Range<usize>) -> [Column; 6] {
    let all = export.columns;
    let noise = of(&all.noise_dbm, part, 1).map(|dbm| Some(dbm).filter(|dbm| *dbm != NOISE_UNKNOWN_DBM));
    let host = of(&all.host_us, part, 1).map(|us| Some(us).filter(|us| *us != NO_TIME));
    let frame = of(&all.frame, part, 1).map(|number| u32::try_from(number).ok());
    let octets: Vec<u8> = of(&all.mac, part, 6).collect();
    let (octets, _) = octets.as_chunks::<6>();
    let mac = octets.iter().map(|octets| Some(Mac(*octets)).filter(|mac| !mac.is_zero()).map(|mac| mac.to_string()));
    let figure = |values: &[f64]| -> ArrayRef {
        Arc::new(
            of(values, part, 1).map(|value| Some(value).filter(|value| value.is_finite())).collect::<Float64Array>(),
        )
    };
    [
        column("host_time", "UTC", true, Arc::new(TimestampMicrosecondArray::from_iter(host).with_timezone("UTC"))),
        column("mac", "", true, Arc::new(StringArray::from_iter(mac))),
        column("frame_count", "", true, Arc::new(UInt32Array::from_iter(frame))),
        column("noise_dbm", "dBm", true, Arc::new(Int8Array::from_iter(noise))),
        column("total_rss_dbm", "dBm", true, figure(&figures.rss_dbm)),
        column("scale", "sqrt(SNR) per unit", true, figure(&figures.scale)),
    ]
}

/// One part of the CSI: the card's integers, or scaled CSI as floats; null where a record has none.
fn lists(
    export: &Export<'_>,
    name: &str,
    csi: &[Complex32],
    size: usize,
    part: fn(&Complex32) -> f32,
) -> io::Result<Column> {
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
    Ok(column(name, unit, false, Arc::new(list.map_err(io::Error::other)?)))
}
