//! `noctule-controller`: the thin controller process, watched by a supervisor and by the platform's own watchdog.

fn main() -> std::process::ExitCode {
    noctule::cli_controller::main()
}
