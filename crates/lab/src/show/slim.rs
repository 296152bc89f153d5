//! SVG in a tenth of its bytes, for pages that hold many pictures: dots of one look become one path, lines go from point to
//! point by steps of a tenth of a pixel. What is drawn over what stays so.

use std::collections::BTreeSet;
use std::fmt::Write;

/// A filled circle without an edge.
struct Dot<'a> {
    at: [i64; 2],
    look: Look<'a>,
}

/// What dots of one path have in common, as it stands in the picture.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Look<'a> {
    r: &'a str,
    fill: &'a str,
    opacity: &'a str,
}

/// Dots that follow each other.
struct Run<'a> {
    look: Look<'a>,
    /// The first one as it stood there.
    tag: &'a str,
    places: Vec<[i64; 2]>,
    seen: BTreeSet<[i64; 2]>,
}

/// The picture with fewer bytes. Dots stand on whole pixels, and those that stand on each other are one.
pub(super) fn slim(svg: &str) -> String {
    let (mut out, mut rest) = (String::with_capacity(svg.len() / 4), svg);
    let mut run: Option<Run<'_>> = None;
    while let Some(at) = rest.find('<') {
        let (before, from_tag) = rest.split_at(at);
        let (tag, after) = from_tag.split_at(from_tag.find('>').map_or(from_tag.len(), |end| end + 1));
        rest = after;
        let dot = Dot::of(tag).filter(|_| before.trim().is_empty());
        if let (Some(run), Some(dot)) = (&mut run, &dot)
            && run.look == dot.look
        {
            run.add(dot.at);
            continue;
        }
        if let Some(run) = run.take() {
            run.write(&mut out);
        }
        out.push_str(before);
        match dot {
            Some(Dot { at, look }) => {
                let mut new = Run { look, tag, places: Vec::new(), seen: BTreeSet::new() };
                new.add(at);
                run = Some(new);
            }
            None => out.push_str(&slim_path(tag).unwrap_or_else(|| tag.to_owned())),
        }
    }
    if let Some(run) = run {
        run.write(&mut out);
    }
    out.push_str(rest);
    out
}

/// Names and values of a tag's attributes.
fn attributes(tag: &str) -> impl Iterator<Item = (&str, &str)> {
    let mut parts = tag.split('"');
    std::iter::from_fn(move || {
        let name = parts.next()?.rsplit(' ').next()?.strip_suffix('=')?;
        Some((name, parts.next()?))
    })
}

impl<'a> Dot<'a> {
    /// `None` for everything that has more to it than a place, a radius and a filling.
    fn of(tag: &'a str) -> Option<Self> {
        let inner = tag.strip_prefix("<circle ")?;
        let (mut at, mut look) = ([None; 2], Look { r: "", fill: "", opacity: "1" });
        for (name, value) in attributes(inner) {
            match name {
                "cx" => at[0] = value.parse::<f64>().ok(),
                "cy" => at[1] = value.parse::<f64>().ok(),
                "r" => look.r = value,
                "fill" => look.fill = value,
                "fill-opacity" => look.opacity = value,
                _ => return None,
            }
        }
        let known = look.r.parse::<f64>().is_ok() && !look.fill.is_empty();
        let [Some(x), Some(y)] = at else { return None };
        known.then_some(Self { at: [x.round() as i64, y.round() as i64], look })
    }
}

impl Run<'_> {
    fn add(&mut self, at: [i64; 2]) {
        if self.seen.insert(at) {
            self.places.push(at);
        }
    }

    /// A line of no length has round ends: a dot.
    fn write(&self, out: &mut String) {
        let Ok(r) = self.look.r.parse::<f64>() else { return };
        if self.places.len() < 2 {
            return out.push_str(self.tag);
        }
        out.push_str("<path d=\"");
        let mut last = [0, 0];
        for place in &self.places {
            out.push('m');
            step(out, [10 * (place[0] - last[0]), 10 * (place[1] - last[1])]);
            out.push_str("h0");
            last = *place;
        }
        let (Look { fill, opacity, .. }, width) = (self.look, 2.0 * r);
        let _ = write!(
            out,
            "\" fill=\"none\" stroke=\"{fill}\" stroke-opacity=\"{opacity}\" stroke-width=\"{width}\" \
             stroke-linecap=\"round\"/>"
        );
    }
}

/// A step in tenths of a pixel.
fn step(out: &mut String, tenths: [i64; 2]) {
    for (k, value) in tenths.into_iter().enumerate() {
        if k > 0 && value >= 0 {
            out.push(' ');
        }
        let (sign, whole, tenth) = (if value < 0 { "-" } else { "" }, value.abs() / 10, value.abs() % 10);
        let _ = match (whole, tenth) {
            (whole, 0) => write!(out, "{sign}{whole}"),
            (0, tenth) => write!(out, "{sign}.{tenth}"),
            (whole, tenth) => write!(out, "{sign}{whole}.{tenth}"),
        };
    }
}

/// A path of straight lines by steps; `None` for every other tag.
fn slim_path(tag: &str) -> Option<String> {
    let (head, rest) = tag.strip_prefix("<path ")?.split_once("d=\"").filter(|(head, _)| head.is_empty())?;
    let (line, tail) = rest.split_once('"')?;
    let mut out = format!("<path {head}d=\"");
    let (mut last, mut numbers) = ([0_i64; 2], Vec::with_capacity(2));
    let (mut command, mut drawn) = ('M', ' ');
    for word in words(line) {
        match word {
            "M" => command = 'm',
            "L" => command = 'l',
            "Z" => out.push('z'),
            number => numbers.push((number.parse::<f64>().ok().filter(|v| v.is_finite())? * 10.0).round() as i64),
        }
        let [x, y] = numbers[..] else { continue };
        numbers.clear();
        let by = [x - last[0], y - last[1]];
        last = [x, y];
        if command == 'l' && by == [0, 0] {
            continue;
        }
        // The first pair is a place, and a letter that stays the same needs not be said again.
        if command != drawn || command == 'm' {
            out.push(command);
        } else if by[0] >= 0 {
            out.push(' ');
        }
        drawn = command;
        step(&mut out, by);
    }
    out.push('"');
    out.push_str(tail);
    numbers.is_empty().then_some(out)
}

/// Letters and numbers of a path.
fn words(line: &str) -> impl Iterator<Item = &str> {
    let apart = |word| {
        let letter: &str = word;
        letter.split_at(usize::from(letter.starts_with(['M', 'L', 'Z'])))
    };
    line.split([' ', ',']).map(apart).flat_map(|(letter, number)| [letter, number]).filter(|word| !word.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dots_of_one_look_become_one_path_and_stay_below_what_is_drawn_later() {
        let dot = |x: f64, y: f64, fill: &str| {
            format!("<circle cx=\"{x}\" cy=\"{y}\" r=\"3\" fill=\"{fill}\" fill-opacity=\"0.5\" />")
        };
        let ring = "<circle cx=\"9\" cy=\"9\" r=\"4\" fill=\"none\" stroke=\"#000\" />";
        let svg = format!(
            "<svg><g>{}\n{}{}{}<text x=\"1\">a &lt; b</text>{}{ring}</g></svg>",
            dot(10.2, 20.0, "#111"),
            dot(12.0, 18.6, "#111"),
            dot(12.4, 19.4, "#111"),
            dot(5.0, 5.0, "#222"),
            dot(6.0, 6.0, "#222"),
        );
        let expected = format!(
            "<svg><g><path d=\"m10 20h0m2-1h0\" fill=\"none\" stroke=\"#111\" stroke-opacity=\"0.5\" stroke-width=\"6\" \
             stroke-linecap=\"round\"/>{}<text x=\"1\">a &lt; b</text>{}{ring}</g></svg>",
            dot(5.0, 5.0, "#222"),
            dot(6.0, 6.0, "#222"),
        );
        assert_eq!(slim(&svg), expected);
    }

    #[test]
    fn lines_go_by_steps_and_what_is_no_line_stays() {
        let line = "<path d=\"M 140.19 707.89 L 140.84 707.62 L 140.843 707.621 L 141.5,706.99 Z\" stroke=\"#111\" />";
        assert_eq!(slim(line), "<path d=\"m140.2 707.9l.6-.3 .7-.6z\" stroke=\"#111\" />");
        let two = "<path d=\"M1,2 L3,4 M0,0 L5,0\"/>";
        assert_eq!(slim(two), "<path d=\"m1 2l2 2m-3-4l5 0\"/>");
        for other in [
            "<path d=\"M 1 2 C 3 4 5 6 7 8\"/>",
            "<path d=\"M 1 NaN L 2 3\"/>",
            "<path d=\"M 1\"/>",
            "<path",
            "a < b",
            "",
        ] {
            assert_eq!(slim(other), other);
        }
    }

    #[test]
    fn errors_do_not_add_up_along_a_line() {
        let points: Vec<f64> = (0..5_000).map(|k| f64::from(k) * 0.237).collect();
        let line: String = points.iter().map(|x| format!("L {x} {x} ")).collect();
        let thin = slim(&format!("<path d=\"M 0 0 {line}\"/>"));
        let steps = thin.split('l').nth(1).unwrap().trim_end_matches("\"/>");
        let sum: f64 = steps.split(' ').step_by(2).map(|step| step.parse::<f64>().unwrap()).sum();
        assert!((sum - points[4_999]).abs() < 0.06, "{sum}");
        assert!(thin.len() < 40_000, "{}", thin.len());
    }
}
