//! Self-contained HTML pages: one file, readable offline, in light and dark.

use super::figure::{Figure, FigureError};
use crate::output::{self, Existing, OutputError};
use std::fmt::Write as _;
use std::path::Path;

/// An HTML page under construction; every text given to it is escaped.
#[derive(Debug, Clone)]
pub struct Page {
    title: String,
    body: String,
}

impl Page {
    /// An empty page with a title.
    pub fn new(title: impl Into<String>) -> Self {
        Self { title: title.into(), body: String::new() }
    }

    /// A section heading.
    #[must_use]
    pub fn heading(self, text: &str) -> Self {
        self.element("h2", text)
    }

    /// A heading below a section heading.
    #[must_use]
    pub fn subheading(self, text: &str) -> Self {
        self.element("h3", text)
    }

    /// A paragraph.
    #[must_use]
    pub fn paragraph(self, text: &str) -> Self {
        self.element("p", text)
    }

    /// A paragraph set apart: the answer, or a warning.
    #[must_use]
    pub fn callout(mut self, text: &str) -> Self {
        let _ = writeln!(self.body, "<p class=\"callout\">{}</p>", escaped(text));
        self
    }

    /// A bulleted list.
    #[must_use]
    pub fn list<S: AsRef<str>>(mut self, items: &[S]) -> Self {
        self.body.push_str("<ul>\n");
        for item in items {
            let _ = writeln!(self.body, "<li>{}</li>", escaped(item.as_ref()));
        }
        self.body.push_str("</ul>\n");
        self
    }

    /// Text kept as it stands, for commands and configuration.
    #[must_use]
    pub fn code(mut self, text: &str) -> Self {
        let _ = writeln!(self.body, "<pre>{}</pre>", escaped(text));
        self
    }

    /// A table; cells that read as numbers are set right.
    #[must_use]
    pub fn table<H: AsRef<str>, C: AsRef<str>>(mut self, header: &[H], rows: &[Vec<C>]) -> Self {
        self.body.push_str("<div class=\"wide\"><table>\n<thead><tr>");
        for cell in header {
            let _ = write!(self.body, "<th>{}</th>", escaped(cell.as_ref()));
        }
        self.body.push_str("</tr></thead>\n<tbody>\n");
        for row in rows {
            self.body.push_str("<tr>");
            for cell in row {
                let cell = cell.as_ref();
                let class = if is_number(cell) { " class=\"number\"" } else { "" };
                let _ = write!(self.body, "<td{class}>{}</td>", escaped(cell));
            }
            self.body.push_str("</tr>\n");
        }
        self.body.push_str("</tbody></table></div>\n");
        self
    }

    /// A figure, as inline SVG, over its caption.
    ///
    /// # Errors
    /// When the figure cannot be drawn.
    pub fn figure(mut self, figure: &Figure, caption: &str) -> Result<Self, FigureError> {
        let svg = figure.svg()?;
        let label = escaped(if figure.title().is_empty() { caption } else { figure.title() });
        let svg = svg.replacen("<svg ", &format!("<svg role=\"img\" aria-label=\"{label}\" "), 1);
        let _ = writeln!(self.body, "<figure>\n{svg}<figcaption>{}</figcaption>\n</figure>", escaped(caption));
        Ok(self)
    }

    /// The page as one HTML document.
    pub fn html(&self) -> String {
        let title = escaped(&self.title);
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<main>\n<h1>{title}</h1>\n{}</main>\n\
             </body>\n</html>\n",
            self.body
        )
    }

    /// Writes the page to a file; a page that is there is replaced.
    ///
    /// # Errors
    /// When the file cannot be written, or holds something else than a page.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<(), OutputError> {
        output::write(path, self.html(), Existing::Keep)
    }

    fn element(mut self, tag: &str, text: &str) -> Self {
        let _ = writeln!(self.body, "<{tag}>{}</{tag}>", escaped(text));
        self
    }
}

/// Inverting lightness and turning the hue back keeps the colours of a figure while its paper turns dark.
const STYLE: &str = "\
:root { color-scheme: light dark; --paper: #ffffff; --ink: #222222; --soft: #666666; --line: #d8d8d8; --shade: #f4f4f4; \
--accent: #0072b2; }
@media (prefers-color-scheme: dark) {
  :root { --paper: #16181c; --ink: #e4e4e4; --soft: #a0a0a0; --line: #3a3d44; --shade: #202329; --accent: #56b4e9; }
  figure svg { filter: invert(0.91) hue-rotate(180deg); }
}
body { margin: 0; background: var(--paper); color: var(--ink); font: 16px/1.55 \"DejaVu Sans\", Verdana, sans-serif; }
main { max-width: 1000px; margin: 0 auto; padding: 2rem 1.25rem 4rem; }
h1 { font-size: 1.7rem; line-height: 1.25; margin: 0 0 1rem; }
h2 { font-size: 1.25rem; margin: 2.2rem 0 0.6rem; padding-bottom: 0.25rem; border-bottom: 1px solid var(--line); }
h3 { font-size: 1.05rem; margin: 1.6rem 0 0.4rem; }
p, ul { margin: 0.6rem 0; }
.callout { border-left: 4px solid var(--accent); background: var(--shade); padding: 0.7rem 1rem; }
pre { background: var(--shade); padding: 0.7rem 1rem; white-space: pre-wrap; font-size: 0.85rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; margin: 0.8rem 0; font-size: 0.9rem; }
th, td { padding: 0.3rem 0.8rem; border-bottom: 1px solid var(--line); text-align: left; vertical-align: top; }
th { border-bottom: 2px solid var(--soft); }
td.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
figure { margin: 1.2rem 0; }
figure svg { width: 100%; height: auto; display: block; }
figcaption { color: var(--soft); font-size: 0.9rem; margin-top: 0.3rem; }
@media print { main { max-width: none; } figure, table { break-inside: avoid; } }
";

fn is_number(cell: &str) -> bool {
    let cell = cell.trim().trim_end_matches('%').trim_end();
    cell.replace('\u{2212}', "-").parse::<f64>().is_ok()
}

pub(crate) fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            _ => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::figure::Panel;

    fn page() -> Page {
        let figure =
            Figure::new("a < b").panel(Panel::new("time (s)", "speed (rpm)").line("m", &[(0.0, 1.0), (1.0, 2.0)]));
        Page::new("Bench <3>")
            .heading("Runs & such")
            .callout("named: \"dead-zone\"")
            .table(&["run", "rpm"], &[vec!["d50", "32.5"], vec!["<script>", "n/a"]])
            .figure(&figure, "Speed")
            .unwrap()
    }

    #[test]
    fn text_is_escaped_and_nothing_is_fetched() {
        let html = page().html();
        assert!(html.contains("<h1>Bench &lt;3&gt;</h1>"));
        assert!(html.contains("Runs &amp; such"));
        assert!(!html.contains("<script"));
        assert!(html.contains("aria-label=\"a &lt; b\""));
        let links = html.replace("http://www.w3.org/2000/svg", "");
        assert!(!links.contains("http") && !links.contains("src=") && !links.contains("@import"));
    }

    #[test]
    fn numbers_are_set_right() {
        let html = page().html();
        assert!(html.contains("<td class=\"number\">32.5</td>"));
        assert!(html.contains("<td>n/a</td>"));
    }
}
