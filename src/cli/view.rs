//! `noctule view`: the live page, a process of its own; and as `demo`'s child.

use super::args::ViewArguments;
use super::output::print_line;
use super::run::{ipc_failure, stop_flag};
use super::{Failure, exit};
use crate::view::{ViewError, ViewOptions, ViewServer};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Serves the page until Ctrl-C; prints its address first.
///
/// # Errors
/// 2 for a token that cannot be used, 69 for an address that cannot be listened on, 78, and the codes of the transport.
pub fn view(arguments: &ViewArguments) -> Result<(), Failure> {
    let config = super::config::load(&arguments.choice)?;
    let stop = stop_flag()?;
    let options = ViewOptions {
        listen: arguments.listen,
        or_any_port: arguments.with_parent,
        token: arguments.token.clone(),
        origins: arguments.allow_origin.clone(),
    };
    let server = ViewServer::open(&config, &options).map_err(|error| failure(&error))?;
    if arguments.with_parent {
        end_with_parent(&stop)?;
    }
    print_line(&server.url())?;
    if !server.address().ip().is_loopback() {
        log::warn!(
            "the page is open to the network, without encryption: whoever has its address with the token can look"
        );
    }
    server.serve(&stop).map_err(|error| failure(&error))
}

fn failure(error: &ViewError) -> Failure {
    match error {
        ViewError::Address { .. } => Failure::new(exit::UNAVAILABLE, error),
        ViewError::Token(_) => Failure::new(exit::USAGE, error),
        ViewError::Parameter(_) => Failure::new(exit::CONFIG, error),
        ViewError::Ipc(error) => ipc_failure(error),
        ViewError::Runtime(_) => Failure::new(exit::INTERNAL, error),
    }
}

/// Ends the page when standard input does: the parent holds its other end, and loses it however it ends itself.
fn end_with_parent(stop: &Arc<AtomicBool>) -> Result<(), Failure> {
    let stop = Arc::clone(stop);
    let wait = move || {
        let _ = std::io::copy(&mut std::io::stdin().lock(), &mut std::io::sink());
        stop.store(true, Ordering::Relaxed);
    };
    std::thread::Builder::new().name("noctule-view parent".to_owned()).spawn(wait)?;
    Ok(())
}
