//! The `noctule` program: daemon and tools. Everything is in the library; see [`noctule::cli`].

use std::process::ExitCode;

fn main() -> ExitCode {
    noctule::cli::main()
}
