//! `twum ports`.

use anyhow::{Context, Result};
use serialport::SerialPortType;
use std::process::ExitCode;

/// Arguments of `twum ports`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  twum ports --json")]
pub struct Args {
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs `twum ports`.
pub fn run(args: Args) -> Result<ExitCode> {
    let ports = serialport::available_ports().context("the system does not list its serial ports")?;
    let rows: Vec<(String, String)> = ports
        .into_iter()
        .map(|port| {
            let what = match port.port_type {
                SerialPortType::UsbPort(usb) => {
                    let words = [usb.manufacturer, usb.product].into_iter().flatten().collect::<Vec<_>>().join(" ");
                    format!("USB {:04x}:{:04x} {words}", usb.vid, usb.pid)
                }
                SerialPortType::BluetoothPort => "Bluetooth".to_owned(),
                SerialPortType::PciPort => "PCI".to_owned(),
                SerialPortType::Unknown => String::new(),
            };
            (port.port_name, what.trim_end().to_owned())
        })
        .collect();
    if args.json {
        let list: Vec<_> = rows.iter().map(|(port, what)| serde_json::json!({ "port": port, "what": what })).collect();
        println!("{}", serde_json::json!(list));
    } else if rows.is_empty() {
        eprintln!("no serial ports; plug the board in, or use `--port sim`");
    } else {
        rows.iter().for_each(|(port, what)| println!("{port}  {what}"));
    }
    Ok(ExitCode::SUCCESS)
}
