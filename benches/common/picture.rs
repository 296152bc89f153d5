//! Pictures of results. Only the crate `csi5300-lab` has kuva.

use crate::common::out;
use kuva::prelude::*;

/// One line of a picture.
pub struct Series {
    pub label: String,
    pub points: Vec<(f64, f64)>,
}

/// A log-log picture.
pub fn picture(name: &str, title: &str, x: &str, y: &str, series: &[Series]) {
    let colors = [
        "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#999999", "#8b4513", "#556b2f",
        "#9400d3", "#b22222", "#ff69b4", "#00008b",
    ];
    let mut plots: Vec<Plot> = Vec::new();
    for (i, s) in series.iter().enumerate() {
        let color = colors[i % colors.len()];
        let mut sorted = s.points.clone();
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
        plots.push(LinePlot::new().with_data(sorted.clone()).with_color(color).with_legend(s.label.clone()).into());
        plots.push(ScatterPlot::new().with_data(sorted).with_color(color).with_size(4.0).into());
    }
    let layout = Layout::auto_from_plots(&plots).with_title(title).with_x_label(x).with_y_label(y).with_log_scale();
    let png = kuva::render_to_png(plots, layout, 2.0).expect("the picture renders");
    let path = out(&format!("{name}.png"));
    std::fs::write(&path, png).expect("the picture can be written");
    println!("written: {}", path.display());
}
