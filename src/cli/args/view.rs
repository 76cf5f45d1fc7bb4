//! `noctule view` as it may be typed.

use super::ConfigChoice;
use clap::Args;
use std::net::SocketAddr;

/// Where the page listens without another wish.
pub const DEFAULT_LISTEN: &str = "127.0.0.1:8765";

/// `view`.
#[derive(Debug, Args)]
#[command(after_help = "\
Foxglove and Lichtblick connect to ws://127.0.0.1:8765. The page only looks: it commands nothing. /metrics has the numbers for
Prometheus, /healthz is one word. From another machine, encrypted: ssh -L 8765:127.0.0.1:8765 robot

Examples:
  noctule view                                     then open http://127.0.0.1:8765/
  noctule view --config robot.toml --listen 0.0.0.0:8765
                                                   for the network: prints an address with a token of its own
  noctule view --allow-origin https://app.foxglove.dev
                                                   let Foxglove's web page connect as well")]
pub struct ViewArguments {
    #[command(flatten)]
    pub choice: ConfigChoice,
    /// Address and port to listen on; port 0 takes any free one.
    #[arg(long, value_name = "ADDRESS:PORT", default_value = DEFAULT_LISTEN)]
    pub listen: SocketAddr,
    /// Token to ask for, 16 to 256 letters and digits; other users of this machine can see it in the list of processes.
    /// Elsewhere than on loopback one is made without it.
    #[arg(long, value_name = "T")]
    pub token: Option<String>,
    /// Origin of another site's page that may open the Foxglove socket, with its scheme (see the examples); may be given repeatedly.
    #[arg(long, value_name = "ORIGIN")]
    pub allow_origin: Vec<String>,
    /// End with the process at the other end of standard input, and take another port where this one is in use; for `demo`.
    #[arg(long, hide = true)]
    pub with_parent: bool,
}
