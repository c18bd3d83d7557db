use super::*;

fn read_text(name: &str, text: &str, options: &ReadOptions) -> Result<Sweep, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, text).unwrap();
    read(&path, options).map_err(|e| e.to_string())
}

/// The same one-port in every format: 1 kΩ beside 1 nF.
fn expected(f: f64) -> Complex<f64> {
    Complex::new(1e-3, TAU * f * 1e-9)
}

fn rows(make: impl Fn(f64, Complex<f64>) -> String) -> String {
    (0..30).map(|i| 40_000.0 + 100.0 * f64::from(i)).map(|f| make(f, expected(f)) + "\n").collect()
}

fn agrees(sweep: &Sweep) {
    for p in &sweep.points {
        let e = expected(p.frequency_hz);
        assert!((p.admittance_s - e).norm() < 1e-6 * e.norm(), "{p:?}");
    }
    assert_eq!(sweep.points.len(), 30);
}

#[test]
fn every_format_says_the_same() {
    let none = ReadOptions::default();
    let z = rows(|f, y| format!("{f},{:.12e},{:.12e}", (1.0 / y).re, (1.0 / y).im));
    agrees(&read_text("a.csv", &format!("# a comment\nfrequency_hz,z_re,z_im\n{z}"), &none).unwrap());
    let y = rows(|f, y| format!("{f};x;{:.12e};{:.12e}", y.re, y.im));
    agrees(&read_text("a.csv", &format!("Frequency_Hz;note;G;B\n{y}"), &none).unwrap());
    let one = Complex::new(1.0, 0.0);
    let s = |y: Complex<f64>| (one - y * 50.0) / (one + y * 50.0);
    let ma = rows(|f, y| format!("{} {:.12} {:.12} ! c", f / 1e3, s(y).norm(), s(y).arg().to_degrees()));
    agrees(&read_text("a.s1p", &format!("! t\n# kHz S MA R 50\n{ma}"), &none).unwrap());
    let db = rows(|f, y| format!("{} {:.12} {:.12}", f / 1e9, 20.0 * s(y).norm().log10(), s(y).arg().to_degrees()));
    agrees(&read_text("a.S1P", &format!("# GHz S DB R 50\n{db}"), &none).unwrap());
    let z = rows(|f, y| format!("{f} {:.12e} {:.12e}", (1.0 / y).re / 75.0, (1.0 / y).im / 75.0));
    agrees(&read_text("a.s1p", &format!("# Hz Z RI R 75\n{z}"), &none).unwrap());
    let y = rows(|f, y| format!("{f} {:.12e} {:.12e}", y.re, y.im));
    let two = format!("[Version] 2.0\n# Hz Y RI R 75\n[Number of Ports] 1\n[Network Data]\n{y}[End]\n");
    agrees(&read_text("a.s1p", &two, &none).unwrap());
}

#[test]
fn waveforms_give_the_admittance_on_either_side_of_the_shunt() {
    for shunt in [Shunt::High, Shunt::Low] {
        let options = ReadOptions { shunt_ohm: Some(2000.0), shunt, stray_f: 0.0 };
        let wave = |f: f64, y: Complex<f64>| {
            let divider = (y * 2000.0 + 1.0).inv();
            let v2 = if shunt == Shunt::High { divider } else { Complex::new(1.0, 0.0) - divider };
            (0..200).map(move |k| {
                let t = f64::from(k) * 1e-6;
                // Not triggered at zero: the phase of channel 1 must not matter.
                let a = TAU * f * t + 0.8;
                (t, 3.0 * a.sin(), 3.0 * v2.norm() * (a + v2.arg()).sin())
            })
        };
        let whole = rows(|f, y| {
            wave(f, y).map(|(t, a, b)| format!("{f},{t:.9e},{a:.12e},{b:.12e}")).collect::<Vec<_>>().join("\n")
        });
        agrees(&read_text("a.csv", &format!("frequency_hz,time_s,v1,v2\n{whole}"), &options).unwrap());
        let folder = tempfile::tempdir().unwrap();
        for i in 0..30 {
            let f = 40_000.0 + 100.0 * f64::from(i);
            let body: String = wave(f, expected(f)).map(|(t, a, b)| format!("{t:.9e},{a:.12e},{b:.12e}\n")).collect();
            let (name, head) = if i % 2 == 0 {
                (format!("f_{f}Hz.csv"), String::new())
            } else {
                (format!("{i}.csv"), format!("# frequency_hz = {f}\n"))
            };
            std::fs::write(folder.path().join(name), format!("{head}time_s,v1,v2\n{body}")).unwrap();
        }
        agrees(&read(folder.path(), &options).unwrap());
    }
}

#[test]
fn what_is_wrong_is_named_with_its_place() {
    let head = "frequency_hz,g,b\n";
    let good = rows(|f, y| format!("{f},{:e},{:e}", y.re, y.im));
    let none = ReadOptions::default();
    for (name, text, parts) in [
        ("a.csv", format!("{head}{good}50000,oops,1\n"), vec!["line 32", "`g`", "oops"]),
        ("a.csv", format!("{head}{good}50000,NaN,1\n"), vec!["line 32", "`g`", "NaN"]),
        ("a.csv", format!("{head}{good}50000,1\n"), vec!["line 32", "2 columns"]),
        ("a.csv", format!("{head}{good}-5,1,1\n"), vec!["line 32", "frequency_hz", "positive"]),
        ("a.csv", format!("{head}{good}5,0,0\n"), vec!["line 32", "zero"]),
        ("a.csv", good.clone(), vec!["line 1", "header", "frequency_hz,z_re,z_im"]),
        ("a.csv", "f,x\n1,2\n".to_owned(), vec!["line 1", "f,x", "expected"]),
        ("a.csv", format!("{head}40000,1,1\n"), vec!["1 distinct", "20"]),
        ("a.csv", String::new(), vec!["empty"]),
        ("a.csv", head.to_owned(), vec!["no data"]),
        ("a.csv", "frequency_hz,time_s,v1,v2\n1,2,3,4\n".to_owned(), vec!["--shunt"]),
        ("a.s1p", "# Hz S MA R 50\n1 2\n".to_owned(), vec!["line 2", "2 numbers"]),
        ("a.s1p", "# Hz Q MA R 50\n".to_owned(), vec!["line 1", "`Q`"]),
        ("a.s1p", "# Hz S MA R 50\n1 -1 x\n".to_owned(), vec!["line 2", "`x`"]),
    ] {
        let message = read_text(name, &text, &none).unwrap_err();
        for part in parts {
            assert!(message.contains(part), "`{part}` is missing in: {message}");
        }
    }
    let missing = read(Path::new("nowhere.csv"), &none).unwrap_err().to_string();
    assert!(missing.contains("nowhere.csv"));
    let dead = rows(|f, _| {
        (0..50).map(|k| format!("{f},{:e},{},0", f64::from(k) * 1e-6, k / 12 % 2)).collect::<Vec<_>>().join("\n")
    });
    let options = ReadOptions { shunt_ohm: Some(2000.0), ..none };
    let message = read_text("a.csv", &format!("frequency_hz,time_s,v1,v2\n{dead}"), &options).unwrap_err();
    assert!(message.contains("v2") && message.contains("40000 Hz"), "{message}");
}
