//! Hold a depth over TCP with JSON lines: the standard library, no crate.
//!
//!     rustc -O depth_hold.rs
//!     uwserver run bluerov2_pool --paused
//!     ./depth_hold 127.0.0.1:7600 2.0
//!
//! The world is stepped by this program: 12 ticks of 240 Hz between two commands. For more than this, take serde_json.

use std::env;
use std::error::Error;
use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::process::ExitCode;

const PERIOD: f64 = 12.0 / 240.0;

struct Server {
    stream: TcpStream,
    lines: BufReader<TcpStream>,
    sample: String,
    id: u64,
}

impl Server {
    fn connect(address: &str) -> Result<Self, Box<dyn Error>> {
        let stream = TcpStream::connect(address)?;
        stream.set_nodelay(true)?;
        let lines = BufReader::new(stream.try_clone()?);
        Ok(Server { stream, lines, sample: String::new(), id: 0 })
    }

    /// Send a request and wait for its reply; samples that come meanwhile are kept.
    fn ask(&mut self, method: &str, params: &str) -> Result<String, Box<dyn Error>> {
        self.id += 1;
        let (id, request) = (self.id, format!(r#"{{"jsonrpc":"2.0","id":{},"method":"{method}","params":{params}}}"#, self.id));
        self.stream.write_all((request + "\n").as_bytes())?;
        loop {
            let mut line = String::new();
            if self.lines.read_line(&mut line)? == 0 {
                return Err("the server left".into());
            }
            if line.contains(r#""method":"sample""#) {
                self.sample = line;
            } else if line.contains(r#""method":"#) {
                continue; // an event, or the progress of a step
            } else if line.contains(&format!(r#""id":{id},"#)) || line.contains(&format!(r#""id":{id}}}"#)) {
                if line.contains(r#""error":"#) {
                    return Err(format!("refused: {}", line.trim()).into());
                }
                return Ok(line);
            }
        }
    }

    /// A number of the newest sample.
    fn newest(&self, field: &str) -> Option<f64> {
        let values = self.sample.split_once(r#""value":"#)?.1;
        let rest = values.split_once(&format!(r#""{field}":"#))?.1;
        rest.split([',', '}']).next()?.trim().parse().ok()
    }
}

fn hold(server: &mut Server, wanted: f64) -> Result<f64, Box<dyn Error>> {
    server.ask("subscribe", r#"{"pattern":"bluerov2/depth","delivery":"latest"}"#)?;
    let (mut before, mut rate, mut sum): (Option<f64>, f64, f64) = (None, 0.0, 0.0);
    for _ in 0..600 {
        server.ask("step", r#"{"n":12}"#)?;
        let Some(depth) = server.newest("depth") else { continue };
        rate += before.map_or(0.0, |last| 0.3 * ((depth - last) / PERIOD - rate));
        before = Some(depth);
        let error = (wanted - depth).clamp(-0.5, 0.5);
        sum = (sum + error * PERIOD).clamp(-1.0, 1.0);
        let u = (0.6 * error + 0.15 * sum - 0.7 * rate).clamp(-1.0, 1.0);
        let value = format!(r#"{{"port":"bluerov2/thrusters","value":{{"u":[0,0,0,0,{u:.4},{u:.4},{u:.4},{u:.4}]}}}}"#);
        server.ask("command", &value)?;
    }
    before.ok_or_else(|| "no depth was heard".into())
}

fn main() -> ExitCode {
    let arguments: Vec<String> = env::args().collect();
    let (Some(address), Some(Ok(wanted))) = (arguments.get(1), arguments.get(2).map(|text| text.parse::<f64>())) else {
        eprintln!("usage: depth_hold HOST:PORT DEPTH");
        return ExitCode::from(2);
    };
    match Server::connect(address).and_then(|mut server| hold(&mut server, wanted)) {
        Ok(depth) => {
            println!("depth {depth:.2} m");
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("depth_hold: {error}");
            ExitCode::FAILURE
        }
    }
}
