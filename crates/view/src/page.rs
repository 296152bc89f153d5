//! The page's files. They are served one by one, or stand in one file together.

/// The plotting library uPlot and its licence: `page/vendor`, from npm's `uplot` as published.
const UPLOT: &str = include_str!("../page/vendor/uPlot.iife.min.js");
const UPLOT_STYLE: &str = include_str!("../page/vendor/uPlot.min.css");
const HEAD: &str = include_str!("../page/index.html");
const STYLE: &str = include_str!("../page/page.css");
/// The page's own script, in the order in which its parts need each other.
const SCRIPTS: [&str; 10] = [
    include_str!("../page/base.js"),
    include_str!("../page/colours.js"),
    include_str!("../page/charts.js"),
    include_str!("../page/log.js"),
    include_str!("../page/map.js"),
    include_str!("../page/profile.js"),
    include_str!("../page/table.js"),
    include_str!("../page/link.js"),
    include_str!("../page/live.js"),
    include_str!("../page/main.js"),
];
/// Where the head names its files.
const FILES: &str = "<!-- files -->";
const LINKED: &str = "<link rel=\"stylesheet\" href=\"/uplot.css\"><link rel=\"stylesheet\" href=\"/page.css\">\
                      <script defer src=\"/uplot.js\"></script><script defer src=\"/page.js\"></script>";

/// A file of the page by its path: its kind and text.
pub(crate) fn file(path: &str) -> Option<(&'static str, String)> {
    Some(match path {
        "" | "/" => ("text/html; charset=utf-8", HEAD.replace(FILES, LINKED)),
        "/uplot.js" => ("text/javascript; charset=utf-8", UPLOT.to_owned()),
        "/uplot.css" => ("text/css; charset=utf-8", UPLOT_STYLE.to_owned()),
        "/page.js" => ("text/javascript; charset=utf-8", SCRIPTS.concat()),
        "/page.css" => ("text/css; charset=utf-8", STYLE.to_owned()),
        _ => return None,
    })
}

/// The page as one file with the answers to its requests: path and JSON of each.
pub(crate) fn whole(title: &str, answers: &[(String, String)]) -> String {
    let name = title.replace('&', "&amp;").replace('<', "&lt;");
    let mut head = HEAD.replace("<title>csi5300</title>", &format!("<title>{name}: csi5300</title>"));
    head = head.replace(FILES, &format!("<style>{UPLOT_STYLE}{STYLE}</style>"));
    let (above, below) = head.rsplit_once("</body>").unwrap_or((&head, ""));
    let mut page = String::with_capacity(answers.iter().map(|answer| answer.1.len() + 64).sum::<usize>() + (1 << 17));
    page.push_str(above);
    page.push_str("<script type=\"application/json\" id=\"answers\">{");
    for (k, (path, json)) in answers.iter().enumerate() {
        // This sign is in strings only: no name from outside can end the element.
        let json = json.replace('<', "\\u003c");
        page.push_str(&format!("{}\"{path}\":{json}", if k == 0 { "" } else { "," }));
    }
    page.push_str("}</script>");
    for script in std::iter::once(UPLOT).chain(SCRIPTS) {
        page.push_str("<script>");
        page.push_str(script);
        page.push_str("</script>");
    }
    page.push_str("</body>");
    page.push_str(below);
    page
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_from_outside_cannot_become_markup() {
        let answers = [("/data/overview".to_owned(), r#"{"name":"</script><script>x()<!--"}"#.to_owned())];
        let page = whole("</title><b>", &answers);
        assert!(!page.contains("<script>x()") && !page.contains("<b>") && !page.contains("x()<!--"));
        let inside = page.split_once("id=\"answers\">").unwrap().1.split_once("</script>").unwrap().0;
        let back: serde_json::Value = serde_json::from_str(inside).unwrap();
        assert_eq!(back["/data/overview"]["name"], "</script><script>x()<!--");
    }

    #[test]
    fn every_file_that_the_page_names_is_there() {
        let (_, head) = file("/").unwrap();
        let named: Vec<&str> = head.split("\"/").skip(1).filter_map(|rest| rest.split('"').next()).collect();
        assert_eq!(named.len(), 4, "{named:?}");
        named.iter().for_each(|name| assert!(file(&format!("/{name}")).is_some(), "{name}"));
        assert!(file("/page/base.js").is_none());
        // What ends a script would end it in the one file too.
        assert!(SCRIPTS.iter().chain([&UPLOT]).all(|script| !script.contains("</script")));
    }
}
