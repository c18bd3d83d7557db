//! A real browser, for tests of pages: Chromium without a window.

use std::process::Command;

/// What a browser showed.
pub(crate) struct Seen {
    /// The document after its scripts ran.
    pub(crate) dom: String,
    /// What was written to the console, and errors nothing caught.
    pub(crate) console: Vec<String>,
}

impl Seen {
    /// The value of the first attribute of this name.
    pub(crate) fn attribute(&self, name: &str) -> &str {
        let (_, after) =
            self.dom.split_once(&format!("{name}=\"")).unwrap_or_else(|| panic!("no {name} in {}", self.dom));
        after.split_once('"').expect("an attribute ends").0
    }
}

/// Shows a page at `fragment` (`#...` or nothing) in a window of this width, runs `script` in it, and waits until it is done;
/// none, said on stderr, where there is no browser.
pub(crate) fn show(html: &str, fragment: &str, script: &str, width_px: u32) -> Option<Seen> {
    let named = std::env::var("CHROMIUM").ok();
    let names = named.as_deref().into_iter().chain(["chromium", "chromium-browser", "google-chrome"]);
    let Some(browser) = names.into_iter().find(|name| Command::new(name).arg("--version").output().is_ok()) else {
        eprintln!("SKIPPED: no Chromium here (set CHROMIUM to name one), the page was not shown");
        return None;
    };
    let folder = tempfile::tempdir().expect("a folder");
    let page = folder.path().join("page.html");
    let run = format!(
        "<script>window.addEventListener(\"load\", () => setTimeout(() => {{{script}}}, 100));</script></body>"
    );
    crate::output::rewrite(&page, html.replacen("</body>", &run, 1)).expect("it can be written");
    let output = Command::new(browser)
        .args(["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"])
        .args(["--disable-background-networking", "--disable-component-update", "--disable-sync"])
        .args(["--enable-logging=stderr", "--virtual-time-budget=3000", "--dump-dom"])
        .arg(format!("--window-size={width_px},900"))
        .arg(format!("--user-data-dir={}", folder.path().join("profile").display()))
        .arg(format!("file://{}{fragment}", page.display()))
        .output()
        .expect("the browser starts");
    let said = String::from_utf8_lossy(&output.stderr);
    let console = said.lines().filter(|line| line.contains("CONSOLE")).map(str::to_owned).collect();
    Some(Seen { dom: String::from_utf8_lossy(&output.stdout).into_owned(), console })
}
