//! The page in a real browser, over its debugging protocol; skipped, said on stderr, where there is none.

use super::served::Served;
use serde_json::{Value, json};
use std::f64::consts::TAU;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tungstenite::{ClientRequestBuilder, Message, WebSocket};
use twum_host::record::recording::Recording;

/// Chromium without a window, on one page.
struct Browser {
    process: Child,
    _profile: tempfile::TempDir,
    socket: WebSocket<TcpStream>,
    asked: u64,
    /// What was written to the console, and errors nothing caught.
    console: Vec<String>,
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

impl Browser {
    fn open(url: &str) -> Option<Self> {
        let named = std::env::var("CHROMIUM").ok();
        let names = named.as_deref().into_iter().chain(["chromium", "chromium-browser", "google-chrome"]);
        let Some(browser) = names.into_iter().find(|name| Command::new(name).arg("--version").output().is_ok()) else {
            eprintln!("SKIPPED: no Chromium here (set CHROMIUM to name one), the page was not shown");
            return None;
        };
        let profile = tempfile::tempdir().unwrap();
        let mut process = Command::new(browser)
            .args(["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"])
            .args([
                "--disable-component-update",
                "--disable-sync",
                "--remote-debugging-port=0",
                "--window-size=1280,900",
            ])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg("about:blank")
            .stderr(Stdio::piped())
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        let mut said = BufReader::new(process.stderr.take().unwrap()).lines().map_while(Result::ok);
        let at = said.find_map(|line| Some(line.split_once("DevTools listening on ws://")?.1.to_owned())).unwrap();
        std::thread::spawn(move || said.for_each(drop));
        let host = at.split('/').next().unwrap().to_owned();
        let mut stream = TcpStream::connect(&host).unwrap();
        write!(stream, "PUT /json/new?about:blank HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").unwrap();
        let mut answer = String::new();
        // The browser keeps the connection: what is needed is the first of it.
        stream.set_read_timeout(Some(Duration::from_secs(2))).unwrap();
        let mut buffer = [0; 4096];
        while !answer.contains("webSocketDebuggerUrl") || !answer.trim_end().ends_with('}') {
            let read = stream.read(&mut buffer).unwrap();
            assert!(read > 0, "{answer}");
            answer += &String::from_utf8_lossy(&buffer[..read]);
        }
        let target: Value = serde_json::from_str(&answer[answer.find('{').unwrap()..]).unwrap();
        let stream = TcpStream::connect(&host).unwrap();
        let uri = target["webSocketDebuggerUrl"].as_str().unwrap().parse().unwrap();
        let (socket, _) = tungstenite::client(ClientRequestBuilder::new(uri), stream).unwrap();
        let mut browser = Self { process, _profile: profile, socket, asked: 0, console: Vec::new() };
        for domain in ["Page", "Runtime", "Log"] {
            browser.call(&format!("{domain}.enable"), json!({}));
        }
        browser.call("Page.navigate", json!({ "url": url }));
        browser.until("document.querySelector('#bar') && document.readyState === 'complete'");
        Some(browser)
    }

    fn call(&mut self, method: &str, parameters: Value) -> Value {
        self.asked += 1;
        let asked = json!({ "id": self.asked, "method": method, "params": parameters });
        self.socket.send(Message::text(asked.to_string())).unwrap();
        loop {
            let Message::Text(text) = self.socket.read().unwrap() else { continue };
            let said: Value = serde_json::from_str(&text).unwrap();
            if said["id"] == self.asked {
                assert!(said["error"].is_null(), "{method}: {said}");
                return said["result"].clone();
            }
            let method = said["method"].as_str().unwrap_or_default();
            if ["Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded"].contains(&method) {
                self.console.push(said["params"].to_string());
            }
        }
    }

    fn script(&mut self, script: &str) -> Value {
        let asked = json!({ "expression": script, "awaitPromise": true, "returnByValue": true });
        let result = self.call("Runtime.evaluate", asked);
        assert!(result["exceptionDetails"].is_null(), "{script}: {result}");
        result["result"]["value"].clone()
    }

    fn until(&mut self, script: &str) {
        self.within(60, script);
    }

    fn within(&mut self, seconds: u64, script: &str) {
        let until = Instant::now() + Duration::from_secs(seconds);
        while self.script(&format!("Boolean({script})")) != true {
            let shown = "document.body.innerText.slice(0, 600)";
            assert!(Instant::now() < until, "{script}: {} {:?}", self.script(shown), self.console);
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    fn key(&mut self, key: &str, code: u32) {
        for kind in ["keyDown", "keyUp"] {
            let mut event = json!({ "type": kind, "key": key, "code": key, "windowsVirtualKeyCode": code });
            if key == "Enter" && kind == "keyDown" {
                event["text"] = json!("\r");
            }
            self.call("Input.dispatchKeyEvent", event);
        }
    }

    /// A click of the mouse where an element is.
    fn click(&mut self, selector: &str) {
        let place = self.script(&format!(
            "(e => {{ e.scrollIntoView({{ block: 'center' }}); const b = e.getBoundingClientRect(); return [b.x + b.width / 2, b.y + b.height / 2]; }})(document.querySelector('{selector}'))"
        ));
        for kind in ["mousePressed", "mouseReleased"] {
            let at = json!({ "type": kind, "x": place[0], "y": place[1], "button": "left", "clickCount": 1 });
            self.call("Input.dispatchMouseEvent", at);
        }
    }

    /// Chooses an element with the keyboard alone, as a person without a mouse does.
    fn enter(&mut self, selector: &str) {
        self.script(&format!("document.querySelector('{selector}').focus()"));
        self.key("Enter", 13);
    }

    /// As wide as a desk's or a phone's screen, light or dark: nothing scrolls sideways. `TWUM_PICTURES` names a folder for
    /// pictures of it.
    fn looks(&mut self, name: &str) {
        let folder = std::env::var("TWUM_PICTURES").ok();
        // Colours change no width.
        for (width, dark) in [(1280, false), (390, true), (1280, true), (390, false)]
            .into_iter()
            .take(if folder.is_some() { 4 } else { 2 })
        {
            let scheme = if dark { "dark" } else { "light" };
            let media = json!({ "features": [{ "name": "prefers-color-scheme", "value": scheme }] });
            self.call("Emulation.setEmulatedMedia", media);
            let screen = json!({ "width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600 });
            self.call("Emulation.setDeviceMetricsOverride", screen);
            // A frame that is out of sight is not drawn.
            self.script("document.querySelector('iframe')?.scrollIntoView(); 0");
            std::thread::sleep(Duration::from_millis(400));
            let wide = self.script("document.documentElement.scrollWidth - document.documentElement.clientWidth");
            assert_eq!(wide, 0, "{name} scrolls sideways at {width} px");
            if let Some(folder) = &folder {
                let picture =
                    self.call("Page.captureScreenshot", json!({ "format": "png", "captureBeyondViewport": true }));
                let data = picture["data"].as_str().unwrap();
                let path = std::path::Path::new(folder).join(format!("{name}-{width}-{scheme}.png.base64"));
                std::fs::write(path, data).unwrap();
            }
        }
        self.call("Emulation.clearDeviceMetricsOverride", json!({}));
    }
}

/// Whether the board says that the motor is off.
const OFF: &str = "document.body.dataset.off === 'true'";
const RUNS: &str = "document.querySelector('#mode').textContent === 'running'";
const IDLE: &str = "document.body.dataset.off === 'true' && !document.querySelector('#run').disabled";

#[test]
fn a_person_runs_stops_and_changes_gains_with_mouse_and_keyboard() {
    let served = Served::sim();
    let Some(mut browser) = Browser::open(&format!("http://{}/", served.address)) else { return };
    browser.until(OFF);
    browser.enter("#take");
    browser.until("document.body.dataset.holder === 'you'");
    browser.until("!document.querySelector('#align').disabled");
    browser.enter("#align");
    browser.until("document.querySelector('#doing').textContent.startsWith('aligned')");
    browser.until(IDLE);

    // The thesis's sine, and the plot moves.
    browser.click("#run");
    browser.until(RUNS);
    let points = browser.script("Number(document.querySelector('.live').dataset.points)").as_f64().unwrap();
    browser.until(&format!("Number(document.querySelector('.live').dataset.points) > {}", points + 40.0));
    browser.looks("bench");
    // The page says when the click came, and when the board said that it is off.
    let watch = "window.stopped = new Promise(done => { const from = performance.now(); const look = () => document.body.dataset.off === 'true' ? done(performance.now() - from) : setTimeout(look, 1); look(); })";
    browser.script(&format!(
        "document.querySelector('#stop').addEventListener('pointerdown', () => {{ {watch} }}, {{ once: true }}); 0"
    ));
    browser.click("#stop");
    let shown_ms = browser.script("window.stopped").as_f64().unwrap();
    println!("{shown_ms:.0} ms from the click to the board's own status on the page");
    assert!(shown_ms < 2000.0, "{shown_ms} ms");
    browser.until(IDLE);

    // kp changes between runs; the keyboard stops from another page.
    browser.script("location.hash = '#settings'; 0");
    browser.until("document.querySelector('input[aria-label=\"control.kp\"]')");
    browser.looks("settings");
    browser.script("(i => { i.value = '50.5'; i.dispatchEvent(new Event('input')); })(document.querySelector('input[aria-label=\"control.kp\"]'))");
    browser.until("!document.querySelector('#send').disabled");
    browser.enter("#send");
    browser.until("document.querySelector('#said').textContent.includes('control.kp = 50.5')");
    for (key, code) in [("Escape", 27), (" ", 32)] {
        browser.script("location.hash = '#bench'; 0");
        browser.until(IDLE);
        browser.enter("#run");
        browser.until(RUNS);
        browser.script("location.hash = '#experiment'; 0");
        browser.key(key, code);
        browser.until(OFF);
    }
    browser.looks("experiment");
    let last = served.until("the run is told of", |state| state["doing"].is_null())["last"]["recording"].clone();
    let path = served.runs().join(format!("{}.mcap", last.as_str().unwrap()));
    assert_eq!(Recording::load(&path).unwrap().runs[0].configuration.unwrap().control.kp, 50.5);

    draws_way_points(&mut browser);
    is_told_of_a_fault(&mut browser);
    let motor = concat!(env!("CARGO_MANIFEST_DIR"), "/crates/motor/motors/pcbmotor-30mm.toml");
    std::fs::copy(motor, served.runs().join("mine.toml")).unwrap();
    looks_at_runs_and_the_model(&mut browser);
    std::fs::write(served.runs().join("stator.csv"), sweep()).unwrap();
    served.has_example("bench3");
    watches_a_sweep(&mut browser);
    sweeps_a_stator(&mut browser);
    diagnoses_the_example(&mut browser);
    browser.call("Page.reload", json!({}));
    browser.until("['nobody', 'another'].includes(document.body?.dataset.holder)");
    assert_eq!(browser.console, Vec::<String>::new());
}

/// A point is added by a click; what cannot be read is not run.
fn draws_way_points(browser: &mut Browser) {
    browser.script("location.hash = '#bench'; 0");
    browser.until(IDLE);
    browser.script("(s => { s.value = 'path'; s.onchange(); })(document.querySelector('#page-bench select')); 0");
    let lines = "document.querySelector('#page-bench textarea').value.trim().split('\\n').length";
    assert_eq!(browser.script(lines), 3);
    browser.click(".drawn");
    assert_eq!(browser.script(lines), 4);
    browser.looks("path");
    browser.script("(t => { t.value = '90 3\\n0'; t.oninput(); })(document.querySelector('#page-bench textarea')); 0");
    browser.enter("#run");
    browser.until("document.querySelector('#said').textContent.includes('way points')");
    assert_eq!(browser.script(OFF), true);
    browser.script("(s => { s.value = 'sine'; s.onchange(); })(document.querySelector('#page-bench select')); 0");
}

/// A bound that the sine leaves: the fault in words, with what to do, until it is cleared.
fn is_told_of_a_fault(browser: &mut Browser) {
    let give = |browser: &mut Browser, value: &str| {
        browser.script("location.hash = '#settings'; 0");
        browser.until("document.querySelector('input[aria-label=\"limits.position_max\"]')");
        browser.script(&format!("(i => {{ i.value = '{value}'; i.dispatchEvent(new Event('input')); }})(document.querySelector('input[aria-label=\"limits.position_max\"]'))"));
        browser.until("!document.querySelector('#send').disabled");
        browser.enter("#send");
        browser
            .until(&format!("document.querySelector('#said').textContent.includes('limits.position_max = {value}')"));
        browser.script("location.hash = '#bench'; 0");
        browser.until(IDLE);
    };
    browser.until("document.querySelector('#force').textContent.includes('kp 50.5')");
    give(browser, "20");
    browser.enter("#run");
    browser.until("document.querySelector('#mode').textContent === 'FAULT PositionBound'");
    browser.until("document.querySelector('#fault').textContent.includes('clear the fault') && document.querySelector('#run').disabled");
    browser.looks("fault");
    browser.until("!document.querySelector('#clear').disabled");
    browser.enter("#clear");
    browser.until(OFF);
    give(browser, "1000000");
}

/// The run in full, two over each other; the model moves with its sliders.
fn looks_at_runs_and_the_model(browser: &mut Browser) {
    browser.script("location.hash = '#runs'; 0");
    browser.until("document.querySelectorAll('#page-runs tbody tr').length === 4");
    browser.looks("runs");
    browser.script("location.hash = '#runs/run-0001-sine.mcap'; 0");
    browser.until("document.querySelectorAll('#plots .uplot').length === 5");
    browser.looks("run");
    browser.enter("#replay");
    browser.until("document.querySelector('#page-runs').textContent.includes('every one is as recorded')");
    browser.script("(s => { s.value = 'run-0002-sine.mcap'; s.dispatchEvent(new Event('change')); })(document.querySelector('[aria-label=\"another run\"]')); 0");
    browser.until("document.querySelector('#plots').textContent.includes('position, run-0002-sine')");
    browser.script("location.hash = '#model'; 0");
    browser.until("document.querySelectorAll('#predicted .uplot').length === 3");
    browser.looks("model");
    // The shipped motor, and the file in the folder.
    browser.until("document.querySelectorAll('#motor option').length === 2");
    browser.script(
        "(s => { s.value = 'mine.toml'; s.dispatchEvent(new Event('change')); })(document.querySelector('#motor')); 0",
    );
    browser.until("document.querySelector('#motor').value === 'mine.toml' && document.querySelector('#predicted').dataset.turn > 1");
    let turn = browser.script("Number(document.querySelector('#predicted').dataset.turn)").as_f64().unwrap();
    browser.script("(i => { i.value = 0; i.dispatchEvent(new Event('input')); })(document.querySelector('input[aria-label=Vrms]')); 0");
    browser.until(&format!("document.querySelector('#predicted').dataset.turn > {turn}"));
}

/// A sweep that was begun: a stator of 2 kΩ and 150 pF behind a shunt of 2 kΩ, at 40 of 401 frequencies.
fn sweep() -> String {
    let mut text = "# sweep 42000 to 46000 Hz by 10 Hz at 6 Vpp\nfrequency_hz,time_s,v1,v2\n".to_owned();
    for hz in (0..40).map(|i| 42e3 + 10.0 * f64::from(i)) {
        let (re, im) = (1.0 + 1.0, 2000.0 * TAU * hz * 150e-12);
        for k in 0..100 {
            let (time_s, angle) = (f64::from(k) * 1e-6, TAU * hz * f64::from(k) * 1e-6);
            text += &format!("{hz},{time_s:e},{:.6},{:.6}\n", re * angle.sin() + im * angle.cos(), angle.sin());
        }
        text += &format!("# done {hz}\n");
    }
    text
}

/// The plots of a sweep that is being made, point by point.
fn watches_a_sweep(browser: &mut Browser) {
    browser.script("location.hash = '#diagnosis'; 0");
    browser.until("document.querySelector('#page-diagnosis option[value=\"stator.csv\"]')");
    browser.script("document.querySelector('#page-diagnosis option[value=\"stator.csv\"]').selected = true; document.querySelector('#page-diagnosis details').open = true; 0");
    browser.enter("#watch-sweep");
    browser.until("document.querySelectorAll('#swept .uplot').length === 3 && document.querySelector('#page-diagnosis').textContent.includes('40 of 401 frequencies')");
    browser.looks("sweep");
    browser.script("document.querySelector('#page-diagnosis option[value=\"stator.csv\"]').selected = false; 0");
    browser.enter("#close-sweep");
}

/// A sweep that is begun here, stopped by a key, gone on with, and identified.
fn sweeps_a_stator(browser: &mut Browser) {
    let set = |label: &str, value: &str| {
        format!(
            "(i => {{ i.value = '{value}'; i.dispatchEvent(new Event('input')); }})([...document.querySelectorAll('#sweeping label')].find(l => l.textContent === '{label}').querySelector('input')); 0"
        )
    };
    browser.enter("#sweeping summary");
    browser.until("document.querySelector('#sweeping').open && !document.querySelector('#sweep').disabled");
    // Space stops; Enter ticks a box.
    let both = "document.querySelector('#sweeping input[type=checkbox]').checked";
    browser.script("document.querySelector('#sweeping input[type=checkbox]').focus(); 0");
    for (key, code, is_ticked) in [("Enter", 13, false), (" ", 32, false), ("Enter", 13, true)] {
        browser.key(key, code);
        assert_eq!(browser.script(both), is_ticked, "{key:?}");
    }
    browser.looks("to-sweep");
    for (label, value) in [("from, Hz", "42000"), ("to, Hz", "46000"), ("step, Hz", "10")] {
        browser.script(&set(label, value));
    }
    browser.enter("#sweep");
    let swept = "Number(document.querySelector('#swept').parentElement.dataset.taken)";
    browser.until(&format!("{swept} > 20 && document.querySelectorAll('#swept .uplot').length === 3"));
    browser.looks("sweeping");
    browser.key("Escape", 27);
    browser.until("document.querySelector('#said').textContent.includes('stopped after') && document.querySelector('#said').textContent.includes('the generator is off')");
    let taken = browser.script(swept).as_f64().unwrap();
    assert!(taken < 401.0, "{taken}");
    browser.until("!document.querySelector('#sweep').disabled");
    browser.enter("#sweep");
    browser.until(&format!(
        "{swept} === 401 && document.querySelector('#doing').textContent.includes('done; the generator is off')"
    ));
    browser.until("document.querySelector('#page-diagnosis option[value=\"stator-1.csv\"]')?.selected");
    browser.enter("#circuit");
    browser.until("document.querySelector('#page-diagnosis iframe')");
    browser.until("document.querySelector('#page-diagnosis pre').textContent.includes('fs')");
    // The answer is what is seen.
    browser.until("document.querySelector('iframe').getBoundingClientRect().top < 400");
    std::thread::sleep(Duration::from_secs(1));
    browser.looks("stator");
    browser.enter("#close-sweep");
    browser.script("document.querySelector('#page-diagnosis option[value=\"stator-1.csv\"]').selected = false; document.querySelector('#page-diagnosis iframe').remove(); 0");
}

/// A shipped folder is diagnosed to the cause that is hidden in it; the report stands in a frame that reaches nothing else.
fn diagnoses_the_example(browser: &mut Browser) {
    browser.script("location.hash = '#diagnosis'; 0");
    browser.until("document.querySelector('#page-diagnosis option[value=bench3]')");
    browser.script("document.querySelector('#page-diagnosis option[value=bench3]').selected = true; 0");
    browser.enter("#diagnose");
    // It gives way to everything else that computes here.
    browser.within(600, "document.querySelector('#page-diagnosis iframe')");
    browser.until("document.querySelector('#page-diagnosis').textContent.includes('NAMED: dead-zone')");
    std::thread::sleep(Duration::from_secs(2));
    browser.looks("diagnosis");
    // The keys stop from within the frame too.
    browser.script("location.hash = '#bench'; 0");
    browser.until(IDLE);
    browser.enter("#run");
    browser.until(RUNS);
    browser.script("location.hash = '#diagnosis'; 0");
    browser.click("#page-diagnosis iframe");
    browser.key("Escape", 27);
    browser.until(OFF);
}
