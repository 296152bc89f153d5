//! A drawing as PDF: the scene's primitives as vectors, its letters in a font that is inside of the file.
use super::Error;
use kuva::render::color::Color;
use kuva::render::render::{PathData, Primitive, Scene, TextAnchor};
use pdf_writer::types::{CidFontType, FontFlags, LineCapStyle, LineJoinStyle, SystemInfo, UnicodeCmap};
use pdf_writer::{Content, Filter, Finish, Name, Pdf, Rect, Ref, Str, TextStr};
use std::collections::BTreeMap;
use std::io::Write;
use ttf_parser::{Face, GlyphId};

/// Letters of Latin and Greek, punctuation and signs of DejaVu Sans; `font/README.md` says how it was made.
const FONT: &[u8] = include_bytes!("font/DejaVuSans-latin-greek.ttf");
const FONT_NAME: Name<'static> = Name(b"CSIDEJ+DejaVuSans");
/// Points of PDF in a pixel: 72 and 96 to the inch.
const PT_PER_PX: f64 = 0.75;
/// Where the handles of a Bezier curve that is a quarter of a circle are: this share of the radius from its ends.
const HANDLE: f64 = 0.552_284_75;

const CATALOG: Ref = Ref::new(1);
const PAGES: Ref = Ref::new(2);
const PAGE: Ref = Ref::new(3);
const CONTENT: Ref = Ref::new(4);
const TYPE0: Ref = Ref::new(5);
const CID: Ref = Ref::new(6);
const DESCRIPTOR: Ref = Ref::new(7);
const FONT_FILE: Ref = Ref::new(8);
const TO_UNICODE: Ref = Ref::new(9);
const INFO: Ref = Ref::new(10);
/// Of the first opacity; the others follow.
const OPACITIES: i32 = 11;

/// The drawing as a PDF of one page of its size.
pub(super) fn render(scene: &Scene, title: &str) -> Result<Vec<u8>, Error> {
    let drawing = |error: &dyn std::fmt::Display| Error::Drawing(error.to_string());
    let face = Face::parse(FONT, 0).map_err(|error| drawing(&error))?;
    let mut page = Page { content: Content::new(), face, glyphs: BTreeMap::new(), opacities: Vec::new() };
    let size = [scene.width, scene.height].map(|px| (px * PT_PER_PX) as f32);
    let scale = PT_PER_PX as f32;
    // Pixels with y down from here on.
    page.content.transform([scale, 0.0, 0.0, -scale, 0.0, size[1]]);
    page.content.set_line_join(LineJoinStyle::RoundJoin);
    scene.elements.iter().for_each(|element| page.draw(element));
    page.finish(size, title).map_err(|error| drawing(&error))
}

/// A page that is drawn.
struct Page {
    content: Content,
    face: Face<'static>,
    /// Glyphs used and the letters that they stand for.
    glyphs: BTreeMap<u16, char>,
    /// Opacities used, in thousandths.
    opacities: Vec<u16>,
}

/// To a hundredth of a pixel: shorter, and finer than any printer.
fn px(value: f64) -> f32 {
    ((value * 100.0).round() / 100.0) as f32
}

fn rgb(colour: &Color) -> Option<[f32; 3]> {
    match colour {
        Color::Rgb(r, g, b) => Some([r, g, b].map(|part| (f32::from(*part) / 255.0 * 1_000.0).round() / 1_000.0)),
        // The canvas names colours by their parts only.
        Color::None | Color::Css(_) => None,
    }
}

impl Page {
    /// One primitive. The canvas makes no others than these.
    fn draw(&mut self, element: &Primitive) {
        match element {
            Primitive::Line { x1, y1, x2, y2, stroke, stroke_width, stroke_dasharray } => {
                self.stroke(&[(*x1, *y1), (*x2, *y2)], stroke, *stroke_width, stroke_dasharray.as_deref());
            }
            Primitive::PolyLine { points, stroke, stroke_width, stroke_dasharray } => {
                self.stroke(points, stroke, *stroke_width, stroke_dasharray.as_deref());
            }
            Primitive::CircleBatch { cx, cy, r, fill, fill_opacity, .. } => {
                self.dots(cx.iter().copied().zip(cy.iter().copied()), *r, fill, *fill_opacity);
            }
            Primitive::Circle { cx, cy, r, stroke: Some(stroke), stroke_width, .. } => {
                self.ring((*cx, *cy), *r, stroke, stroke_width.unwrap_or(1.0));
            }
            Primitive::Path(path) => self.polygon(path),
            Primitive::Rect { x, y, width, height, fill, opacity, .. } => {
                self.with(*opacity, |page| page.cell([*x, *y, *width, *height], fill));
            }
            Primitive::RectBatch { x, y, w, h, fills } => {
                for ((((x, y), w), h), fill) in x.iter().zip(y).zip(w).zip(h).zip(fills) {
                    self.cell([*x, *y, *w, *h], fill);
                }
            }
            Primitive::Text { x, y, content, size, anchor, color, .. } => {
                self.text((*x, *y), &content.replace("\\$", "$"), f64::from(*size), *anchor, color.as_ref());
            }
            Primitive::ClipStart { x, y, width, height, .. } => {
                self.content.save_state().rect(px(*x), px(*y), px(*width), px(*height)).clip_nonzero().end_path();
            }
            Primitive::ClipEnd => {
                self.content.restore_state();
            }
            _ => {}
        }
    }

    /// Draws with an opacity, of lines and areas.
    fn with(&mut self, opacity: Option<f64>, draw: impl FnOnce(&mut Self)) {
        let Some(opacity) = opacity.filter(|opacity| *opacity < 1.0) else { return draw(self) };
        let thousandths = (opacity.max(0.0) * 1_000.0).round() as u16;
        if !self.opacities.contains(&thousandths) {
            self.opacities.push(thousandths);
        }
        self.content.save_state().set_parameters(Name(opacity_name(thousandths).as_bytes()));
        draw(self);
        self.content.restore_state();
    }

    fn stroke(&mut self, points: &[(f64, f64)], colour: &Color, width: f64, dashes: Option<&str>) {
        let (Some([r, g, b]), Some((first, rest))) = (rgb(colour), points.split_first()) else { return };
        let dashes: Vec<f32> = dashes.unwrap_or_default().split(',').filter_map(|part| part.parse().ok()).collect();
        self.content.save_state().set_stroke_rgb(r, g, b).set_line_width(px(width));
        if !dashes.is_empty() {
            self.content.set_dash_pattern(dashes, 0.0);
        }
        self.content.move_to(px(first.0), px(first.1));
        for (x, y) in rest {
            self.content.line_to(px(*x), px(*y));
        }
        self.content.stroke().restore_state();
    }

    /// Dots are lines without length that end in half circles.
    fn dots(&mut self, points: impl Iterator<Item = (f64, f64)>, r: f64, colour: &Color, opacity: Option<f64>) {
        let Some([red, green, blue]) = rgb(colour) else { return };
        self.with(opacity, |page| {
            let content = page.content.save_state();
            content.set_stroke_rgb(red, green, blue).set_line_width(px(2.0 * r)).set_line_cap(LineCapStyle::RoundCap);
            for (x, y) in points {
                content.move_to(px(x), px(y)).line_to(px(x), px(y)).stroke();
            }
            content.restore_state();
        });
    }

    fn ring(&mut self, (x, y): (f64, f64), r: f64, colour: &Color, width: f64) {
        let Some([red, green, blue]) = rgb(colour) else { return };
        self.content.save_state().set_stroke_rgb(red, green, blue).set_line_width(px(width)).move_to(px(x + r), px(y));
        for quarter in 0..4 {
            let angle = f64::from(quarter) * std::f64::consts::FRAC_PI_2;
            let turned = |u: f64, v: f64| {
                (px(x + r * (u * angle.cos() - v * angle.sin())), px(y + r * (u * angle.sin() + v * angle.cos())))
            };
            let [(ax, ay), (bx, by), (cx, cy)] = [turned(1.0, HANDLE), turned(HANDLE, 1.0), turned(0.0, 1.0)];
            self.content.cubic_to(ax, ay, bx, by, cx, cy);
        }
        self.content.close_path().stroke().restore_state();
    }

    /// An area of straight lines: `M x,y L x,y ... Z`.
    fn polygon(&mut self, path: &PathData) {
        let Some([r, g, b]) = path.fill.as_ref().and_then(rgb) else { return };
        let point = |word: &str| {
            let (x, y) = word.trim_start_matches(['M', 'L']).split_once(',')?;
            Some((x.parse::<f64>().ok()?, y.parse::<f64>().ok()?))
        };
        let points: Vec<(f64, f64)> = path.d.split_whitespace().filter_map(point).collect();
        self.with(path.opacity, |page| {
            page.content.set_fill_rgb(r, g, b);
            for (k, (x, y)) in points.iter().enumerate() {
                let (x, y) = (px(*x), px(*y));
                if k == 0 {
                    page.content.move_to(x, y)
                } else {
                    page.content.line_to(x, y)
                };
            }
            page.content.close_path().fill_nonzero();
        });
    }

    fn cell(&mut self, [x, y, width, height]: [f64; 4], colour: &Color) {
        if let Some([r, g, b]) = rgb(colour) {
            self.content.set_fill_rgb(r, g, b).rect(px(x), px(y), px(width), px(height)).fill_nonzero();
        }
    }

    fn text(&mut self, at: (f64, f64), words: &str, size: f64, anchor: TextAnchor, colour: Option<&Color>) {
        let Some([r, g, b]) = colour.map_or(Some([0.0; 3]), rgb) else { return };
        let (mut line, mut width) = (Vec::new(), 0.0);
        for letter in words.chars() {
            // What the font does not have is its empty box.
            let glyph = self.face.glyph_index(letter).unwrap_or(GlyphId(0));
            self.glyphs.entry(glyph.0).or_insert(letter);
            line.extend(glyph.0.to_be_bytes());
            width += f64::from(self.face.glyph_hor_advance(glyph).unwrap_or(0)) * size / self.em();
        }
        let x = match anchor {
            TextAnchor::Start => at.0,
            TextAnchor::Middle => at.0 - width / 2.0,
            TextAnchor::End => at.0 - width,
        };
        self.content.set_fill_rgb(r, g, b).begin_text().set_font(Name(b"F0"), size as f32);
        self.content.set_text_matrix([1.0, 0.0, 0.0, -1.0, px(x), px(at.1)]).show(Str(&line)).end_text();
    }

    /// Units of the font in the size of its letters.
    fn em(&self) -> f64 {
        f64::from(self.face.units_per_em())
    }

    /// The file.
    fn finish(self, [width, height]: [f32; 2], title: &str) -> std::io::Result<Vec<u8>> {
        let mut pdf = Pdf::new();
        pdf.catalog(CATALOG).pages(PAGES);
        pdf.pages(PAGES).kids([PAGE]).count(1);
        pdf.document_info(INFO).title(TextStr(title)).producer(TextStr(concat!("csi5300 ", env!("CARGO_PKG_VERSION"))));
        let mut page = pdf.page(PAGE);
        page.parent(PAGES).media_box(Rect::new(0.0, 0.0, width, height)).contents(CONTENT);
        let mut resources = page.resources();
        resources.fonts().pair(Name(b"F0"), TYPE0);
        let mut states = resources.ext_g_states();
        let numbered = |k: usize| Ref::new(OPACITIES + k as i32);
        for (k, thousandths) in self.opacities.iter().enumerate() {
            states.pair(Name(opacity_name(*thousandths).as_bytes()), numbered(k));
        }
        states.finish();
        resources.finish();
        page.finish();
        for (k, thousandths) in self.opacities.iter().enumerate() {
            let opacity = f32::from(*thousandths) / 1_000.0;
            pdf.ext_graphics(numbered(k)).stroking_alpha(opacity).non_stroking_alpha(opacity);
        }
        self.font(&mut pdf)?;
        pdf.stream(CONTENT, &packed(&self.content.finish())?).filter(Filter::FlateDecode);
        Ok(pdf.finish())
    }

    /// The font with the widths of the letters used, and what they stand for.
    fn font(&self, pdf: &mut Pdf) -> std::io::Result<()> {
        let system = SystemInfo { registry: Str(b"Adobe"), ordering: Str(b"Identity"), supplement: 0 };
        let per_em = 1_000.0 / self.em();
        let units = |value: i16| (f64::from(value) * per_em).round() as f32;
        pdf.type0_font(TYPE0)
            .base_font(FONT_NAME)
            .encoding_predefined(Name(b"Identity-H"))
            .descendant_font(CID)
            .to_unicode(TO_UNICODE);
        let mut cid = pdf.cid_font(CID);
        cid.subtype(CidFontType::Type2).base_font(FONT_NAME).system_info(system).font_descriptor(DESCRIPTOR);
        cid.default_width(0.0).cid_to_gid_map_predefined(Name(b"Identity"));
        let mut widths = cid.widths();
        for glyph in self.glyphs.keys() {
            let advance = f64::from(self.face.glyph_hor_advance(GlyphId(*glyph)).unwrap_or(0)) * per_em;
            widths.consecutive(*glyph, [advance.round() as f32]);
        }
        widths.finish();
        cid.finish();
        let whole = self.face.global_bounding_box();
        let bounds = Rect::new(units(whole.x_min), units(whole.y_min), units(whole.x_max), units(whole.y_max));
        pdf.font_descriptor(DESCRIPTOR)
            .name(FONT_NAME)
            .flags(FontFlags::SYMBOLIC)
            .bbox(bounds)
            .italic_angle(0.0)
            .ascent(units(self.face.ascender()))
            .descent(units(self.face.descender()))
            .cap_height(units(self.face.capital_height().unwrap_or_else(|| self.face.ascender())))
            .stem_v(80.0)
            .font_file2(FONT_FILE);
        let file = packed(FONT)?;
        pdf.stream(FONT_FILE, &file).filter(Filter::FlateDecode).pair(Name(b"Length1"), FONT.len() as i32);
        let mut letters = UnicodeCmap::new(Name(b"Custom"), system);
        self.glyphs.iter().for_each(|(glyph, letter)| letters.pair(*glyph, *letter));
        pdf.cmap(TO_UNICODE, &letters.finish());
        Ok(())
    }
}

fn opacity_name(thousandths: u16) -> String {
    format!("A{thousandths}")
}

fn packed(bytes: &[u8]) -> std::io::Result<Vec<u8>> {
    let mut packer = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::default());
    packer.write_all(bytes)?;
    packer.finish()
}
