//! The ESP32: lines of text of ESP32-CSI-Tool and of Espressif's esp-csi.
//!
//! A line is `CSI_DATA`, columns separated by commas, and the samples in brackets: i8 (i16 where newer esp-csi multiplies them by a
//! gain), imaginary part first, separated by blanks (ESP32-CSI-Tool) or commas (esp-csi). The clock of esp-csi is printed as
//! an i32, which is negative from 36 minutes on. A header line names the columns; without one, their number identifies the
//! tool. Other lines, such as the ESP32's own messages, are skipped.
//!
//! The samples are those of the legacy training field, then of the HT one, 64 subcarriers each at 20 MHz (ESP-IDF,
//! `wifi_csi_info_t`). If a line has both, the HT field is used, as other cards report it; ESP32-CSI-Tool writes only the
//! legacy one. The samples start at the channel centre and continue at the lower edge. If the frame was in the lower half of
//! a 40 MHz channel they are indices -64 to -1; in the upper half, 0 to 63.
//!
//! The ESP32 spoils the first four bytes (`first_word_invalid`): these two subcarriers of the legacy field count as not
//! measured, unless a column says that they are valid.

use crate::{Card, Clock, DETECT, Frame, Kind, RssiUnit, Tones, Why};
use alloc::borrow::ToOwned;
use alloc::string::String;
use alloc::vec::Vec;

/// ESP32-CSI-Tool's columns before the samples.
const TOOL: &str = "\
    type,role,mac,rssi,rate,sig_mode,mcs,bandwidth,smoothing,not_sounding,aggregation,stbc,fec_coding,sgi,\
    noise_floor,ampdu_cnt,channel,secondary_channel,local_timestamp,ant,sig_len,rx_state,real_time_set,\
    real_timestamp,len";
/// esp-csi's columns.
const ESP_CSI: &str = "\
    type,id,mac,rssi,rate,sig_mode,mcs,bandwidth,smoothing,not_sounding,aggregation,stbc,fec_coding,sgi,\
    noise_floor,ampdu_cnt,channel,secondary_channel,local_timestamp,ant,sig_len,rx_state,len,first_word";
/// esp-csi's columns on the ESP32-C5 and C6.
const ESP_CSI_C6: &str =
    "type,id,mac,rssi,rate,noise_floor,fft_gain,agc_gain,channel,local_timestamp,sig_len,rx_state,len,first_word";
const START: &[u8] = b"CSI_DATA";
/// Longest line that is parsed, bytes.
const MAX_LINE: usize = 16 * 1024;
/// Subcarriers in the first four bytes.
const SPOILED: usize = 2;
/// Subcarriers of a training field at 20 MHz.
const FIELD: usize = 64;

/// Names of the columns, from a header line.
pub(crate) type Columns = Vec<String>;

fn names(header: &str) -> Columns {
    header.split(',').map(|name| name.trim().to_owned()).collect()
}

/// Whether one of the first lines is a header or has samples; the ESP32's own messages may precede it.
pub(crate) fn is_log(bytes: &[u8]) -> bool {
    let is_heading = |line: &[u8]| line.starts_with(b"type,") && line.windows(6).any(|word| word == b",mac,r");
    let mut lines = bytes.get(..DETECT).unwrap_or(bytes).split(|byte| *byte == b'\n');
    lines.any(|line| is_heading(line) || line.starts_with(START) && line.contains(&b'['))
}

fn line_of(bytes: &[u8]) -> &[u8] {
    let bytes = bytes.get(..MAX_LINE).unwrap_or(bytes);
    bytes.split(|byte| *byte == b'\n').next().unwrap_or_default()
}

/// The line at the front, or `None` for a header, and its length in bytes.
pub(crate) fn front(bytes: &[u8], columns: &mut Option<Columns>) -> (Option<Result<Frame, Why>>, usize) {
    let line = line_of(bytes);
    let is_whole = line.len() < bytes.len() && line.len() < MAX_LINE;
    let len = line.len() + usize::from(is_whole);
    let Ok(text) = core::str::from_utf8(line) else { return (Some(Err(Why::Damaged)), len) };
    let text = text.trim();
    if text.starts_with("type,") {
        *columns = Some(names(text));
        return (None, len);
    }
    if text.is_empty() {
        return (None, len);
    }
    if !text.as_bytes().starts_with(START) {
        return (Some(Err(Why::NoCsi)), len);
    }
    let why = if len == bytes.len() && !is_whole { Why::Cut } else { Why::Damaged };
    (Some(read(text, columns).ok_or(why)), len)
}

fn read(text: &str, columns: &mut Option<Columns>) -> Option<Frame> {
    let (before, samples) = text.split_once('[')?;
    let (samples, _) = samples.split_once(']')?;
    let fields: Vec<&str> =
        before.trim_end_matches(['"', ' ']).trim_end_matches(',').split(',').map(str::trim).collect();
    let columns = match columns {
        Some(columns) => columns,
        // By the number of columns before the samples.
        None => {
            let known = [TOOL, ESP_CSI, ESP_CSI_C6].into_iter().find(|own| own.split(',').count() == fields.len());
            columns.insert(names(known?))
        }
    };
    let field = |name: &str| fields.get(columns.iter().position(|own| own == name)?).copied();
    let number = |name: &str| field(name)?.parse::<i64>().ok();
    let is_ht = number("sig_mode").map(|mode| mode > 0);
    let is_wide = number("bandwidth") == Some(1);
    let side = number("secondary_channel").unwrap_or(0);
    let values = pairs(samples)?;
    let (subcarriers, mut measured, csi) = training_field(&values, is_ht == Some(true), is_wide, side)?;
    let is_legacy = csi.len() == FIELD && values.get(..FIELD) == Some(&csi[..]);
    if is_legacy && number("first_word").or_else(|| number("first_word_invalid")) != Some(0) {
        measured.iter_mut().take(SPOILED).for_each(|measured| *measured = false);
    }
    let channel = number("channel").and_then(|channel| u16::try_from(channel).ok());
    Some(Frame {
        clock: number("local_timestamp").map(|us| Clock::us((us as u32).into(), 32)),
        host_us: number("real_time_set").filter(|is_set| *is_set == 1).and_then(|_| host_us(field("real_timestamp")?)),
        sender: field("mac").and_then(mac),
        centre_mhz: channel.filter(|channel| (1..=14).contains(channel)).map(|channel| centre_mhz(channel, side)),
        width_mhz: if csi.len() > FIELD { 40 } else { 20 },
        kind: is_ht.map(|is_ht| if is_ht && values.len() > FIELD { Kind::Ht } else { Kind::Legacy }),
        subcarriers,
        measured,
        csi,
        rssi: alloc::vec![number("rssi").and_then(|rssi| i16::try_from(rssi).ok())],
        ..Frame::of(Card::Esp32, RssiUnit::Dbm)
    })
}

/// Numbers in brackets as pairs, imaginary part first.
fn pairs(text: &str) -> Option<Vec<[f32; 2]>> {
    let parts = text.split([' ', ',']).filter(|part| !part.is_empty());
    let numbers: Vec<f32> = parts.map(|part| part.parse::<i16>().ok().map(f32::from)).collect::<Option<_>>()?;
    let (pairs, rest) = numbers.as_chunks::<2>();
    (rest.is_empty() && !pairs.is_empty()).then(|| pairs.iter().map(|[im, re]| [*re, *im]).collect())
}

type Read = (Vec<i16>, Vec<bool>, Vec<[f32; 2]>);

/// The frame's training field among all samples of a line; `side` is the position of a 40 MHz channel's second half: 0 none,
/// 1 above, 2 below.
fn training_field(values: &[[f32; 2]], is_ht: bool, is_wide: bool, side: i64) -> Option<Read> {
    let (legacy, rest) = values.split_at_checked(FIELD)?;
    let whole: Vec<i16> = (0..64).chain(-64..0).collect();
    let (indices, csi, centre) = match (rest.get(..2 * FIELD), rest.get(..FIELD)) {
        (Some(wide), _) if is_ht && is_wide && side != 0 => (whole, wide, 0),
        (_, own) => {
            let csi = own.filter(|_| is_ht && !is_wide).unwrap_or(legacy);
            match side {
                1 => ((-64..0).collect::<Vec<i16>>(), csi, -32),
                2 => ((0..64).collect(), csi, 32),
                _ => ((0..32).chain(-32..0).collect(), csi, 0),
            }
        }
    };
    let kind = if csi.as_ptr() == legacy.as_ptr() { Kind::Legacy } else { Kind::Ht };
    let own = Tones::of(kind, if csi.len() > FIELD { 40 } else { 20 })?.subcarriers;
    let measured = indices.iter().map(|index| own.contains(&(index - centre))).collect();
    Some((indices, measured, csi.to_vec()))
}

/// Centre of the 20 MHz channel, or of the 40 MHz channel whose other half is above (1) or below (2).
const fn centre_mhz(channel: u16, side: i64) -> u16 {
    let own = if channel == 14 { 2_484 } else { 2_407 + 5 * channel };
    match side {
        1 => own + 10,
        2 => own - 10,
        _ => own,
    }
}

/// Seconds with a fraction, as microseconds.
fn host_us(text: &str) -> Option<i64> {
    let seconds: f64 = text.parse().ok()?;
    (seconds.is_finite() && (0.0..1e11).contains(&seconds)).then_some((seconds * 1e6) as i64)
}

fn mac(text: &str) -> Option<[u8; 6]> {
    let mut out = [0; 6];
    let mut parts = text.split(':');
    for octet in &mut out {
        *octet = u8::from_str_radix(parts.next().filter(|part| part.len() == 2)?, 16).ok()?;
    }
    parts.next().is_none().then_some(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Item, items};
    use std::format;
    use std::vec;

    fn samples(pairs: usize, by: &str) -> String {
        (0..pairs).map(|k| format!("{}{by}{}", k % 100, -((k % 100) as i32))).collect::<Vec<_>>().join(by)
    }

    fn frames(log: &str) -> Vec<Frame> {
        let all = items(log.as_bytes()).unwrap();
        all.filter_map(|item| if let Item::Frame(frame) = item { Some(frame) } else { None }).collect()
    }

    #[test]
    fn lines_of_both_tools_are_read_with_and_without_headings() {
        let tool = format!(
            "CSI_DATA,AP,3C:71:BF:6D:2A:78,-73,11,0,0,0,1,1,0,0,0,0,-93,0,6,0,80272146,0,101,0,1,1.5,128,[{} ]\n",
            samples(64, " ")
        );
        let heading = format!("{TOOL},CSI_DATA\n");
        let esp_csi = format!(
            "CSI_DATA,7,3c:71:bf:6d:2a:78,-73,11,0,0,0,1,1,0,0,0,0,-93,0,6,0,80272146,0,101,0,128,0,\"[{}]\"\n",
            samples(64, ",")
        );
        let spoiled = esp_csi.replace(",128,0,", ",128,1,");
        for (log, host_us, first) in [
            (tool.clone(), Some(1_500_000), false),
            (heading + &tool, Some(1_500_000), false),
            (esp_csi, None, true),
            (spoiled, None, false),
        ] {
            let frames = frames(&log);
            let frame = &frames[0];
            assert_eq!(
                (frames.len(), frame.sender, frame.host_us),
                (1, Some([0x3c, 0x71, 0xbf, 0x6d, 0x2a, 0x78]), host_us)
            );
            assert_eq!(
                (frame.clock, frame.centre_mhz, &frame.rssi),
                (Some(Clock::us(80_272_146, 32)), Some(2_437), &vec![Some(-73)])
            );
            assert_eq!((frame.csi[3], frame.subcarriers[32], frame.kind), ([-3.0, 3.0], -32, Some(Kind::Legacy)));
            assert_eq!([0, 1, 26, 27, 37, 38].map(|k| frame.measured[k]), [false, first, true, false, false, true]);
        }
    }

    #[test]
    fn a_signed_clock_and_samples_times_a_gain_are_read() {
        let line = format!(
            "CSI_DATA,7,3c:71:bf:6d:2a:78,-73,11,0,0,0,1,1,0,0,0,0,-93,0,6,0,-2147483648,0,101,0,128,0,[300,-129,{}]\n",
            samples(63, ",")
        );
        let frame = &frames(&line)[0];
        assert_eq!((frame.clock, frame.csi[0]), (Some(Clock::us(1 << 31, 32)), [-129.0, 300.0]));
    }

    #[test]
    fn an_ht_frame_uses_its_ht_field() {
        let line = |bandwidth: u8, side: u8, pairs: usize| {
            frames(&format!(
                "CSI_DATA,1,3C:71:BF:6D:2A:78,-7,11,1,0,{bandwidth},1,1,0,0,0,0,-93,0,6,{side},1,0,101,0,128,0,[{}]\n",
                samples(pairs, " ")
            ))
        };
        let narrow = &line(0, 0, 128)[0];
        assert_eq!(
            (narrow.kind, narrow.csi[0], narrow.csi.len(), narrow.measured[28]),
            (Some(Kind::Ht), [-64.0, 64.0], 64, true)
        );
        let wide = &line(1, 1, 192)[0];
        assert_eq!(
            (wide.width_mhz, wide.csi.len(), wide.centre_mhz, wide.subcarriers[64]),
            (40, 128, Some(2_447), -64)
        );
        let lower = &line(0, 1, 64)[0];
        assert_eq!(
            (lower.subcarriers[0], lower.measured[5], lower.measured[6], lower.measured[32]),
            (-64, false, true, false)
        );
    }

    #[test]
    fn other_lines_are_skipped() {
        let good = format!(
            "CSI_DATA,7,3c:71:bf:6d:2a:78,-73,11,0,0,0,1,1,0,0,0,0,-93,0,6,0,8,0,101,0,128,0,[{}]\n",
            samples(64, ",")
        );
        let log = format!("{good}I (330) wifi: started\n\n{}\n{good}{}", good.trim().replace("-1,", "x,"), &good[..90]);
        let why: Vec<_> = items(log.as_bytes())
            .unwrap()
            .map(|item| if let Item::Skipped(skipped) = item { Some(skipped.why) } else { None })
            .collect();
        assert_eq!(why, [None, Some(Why::NoCsi), Some(Why::Damaged), None, Some(Why::Cut)]);
        assert_eq!(frames(&format!("I (29) boot: ESP-IDF v4.3\n\n{good}")).len(), 1, "messages first");
    }
}
