//! What lies in the root and in shared memory, who lives there, and whether all speak the same version.

use super::Line;
use crate::io::survey::{Participant, Root, Survey, TRANSPORT_VERSION};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Longest wait for Python.
const PYTHON_LIMIT: Duration = Duration::from_secs(5);
const GROUP_OR_OTHERS: u32 = 0o077;
const OTHERS_WRITE: u32 = 0o022;

pub(super) fn look(survey: &Survey, lines: &mut Vec<Line>) {
    lines.push(root(survey));
    neighbours(survey, lines);
    left_overs(survey, lines);
    versions(survey, lines);
    lines.push(python());
}

fn root(survey: &Survey) -> Line {
    const ABOUT: &str = "ipc root";
    let path = survey.root_path.display();
    let ours = rustix::process::geteuid().as_raw();
    match &survey.root {
        Root::Missing { writable: true, .. } => {
            Line::ok(ABOUT, format!("{path}: not there yet; the first start makes it with mode 0700"))
        }
        Root::Missing { above, .. } => Line::problem(
            ABOUT,
            format!("{path}: not there, and user {ours} may not write to {}", above.display()),
            "make it and give it to this user (systemd: RuntimeDirectory=noctule), or set ipc.root",
        ),
        Root::Other(what) => {
            Line::problem(ABOUT, format!("{path}: {what}"), "remove it, or set ipc.root to a directory of this user")
        }
        Root::Directory { owner, .. } if *owner != ours => Line::problem(
            ABOUT,
            format!("{path}: owned by user {owner}, we are {ours}"),
            format!("run as user {owner}, or set ipc.root; all processes of a robot run as one user"),
        ),
        Root::Directory { mode, .. } if mode & OTHERS_WRITE != 0 => {
            Line::problem(ABOUT, format!("{path}: mode {mode:04o}, others can write"), format!("chmod 700 {path}"))
        }
        Root::Directory { parent_mode, .. } if parent_mode & 0o002 != 0 && parent_mode & 0o1000 == 0 => Line::problem(
            ABOUT,
            format!("{path}: lies where others can replace it (mode {parent_mode:04o})"),
            "chmod o-w the directory above it, or set ipc.root",
        ),
        Root::Directory { mode, .. } if mode & GROUP_OR_OTHERS != 0 => {
            Line::note(ABOUT, format!("{path}: mode {mode:04o}, others can read"), "the next start closes it")
        }
        Root::Directory { mode, .. } => Line::ok(ABOUT, format!("{path}: ours alone (mode {mode:04o})")),
    }
}

fn told(participant: &Participant) -> String {
    let process = participant.process.map_or("?".to_owned(), |process| process.to_string());
    format!("{} {process}", participant.name)
}

fn neighbours(survey: &Survey, lines: &mut Vec<Line>) {
    const ABOUT: &str = "processes";
    match &survey.participants {
        None => lines.push(Line::problem(
            ABOUT,
            "the transport does not answer: it waits for what a dead process left half made",
            "stop daemon, controller and clients, then `noctule wipe`",
        )),
        Some(all) => {
            let alive: Vec<String> = all.iter().filter(|one| one.alive).map(told).collect();
            let daemon =
                survey.daemon.map_or("no daemon runs".to_owned(), |process| format!("daemon: process {process}"));
            let others = if alive.is_empty() { String::new() } else { format!("; registered: {}", alive.join(", ")) };
            lines.push(Line::ok(ABOUT, format!("{daemon}{others}")));
        }
    }
    if !survey.other_daemons.is_empty() {
        lines.push(Line::note(
            ABOUT,
            format!("{} daemons of other roots or prefixes run on this machine", survey.other_daemons.len()),
            "meant? then each robot needs its own [ipc]; their shared memory and load count, too",
        ));
    }
}

fn left_overs(survey: &Survey, lines: &mut Vec<Line>) {
    const ABOUT: &str = "left-overs";
    let before = lines.len();
    if let Some((path, owner)) = survey.foreign.first() {
        lines.push(Line::problem(
            ABOUT,
            format!(
                "{} files of this prefix belong to another user: {} to {owner}",
                survey.foreign.len(),
                path.display()
            ),
            "remove them as that user, or choose another ipc.prefix",
        ));
    }
    let wipe = "stop daemon, controller and clients, then `noctule wipe`";
    if let Some(path) = survey.half_made.first() {
        lines.push(Line::problem(
            ABOUT,
            format!("{} half-made files, for example {}", survey.half_made.len(), path.display()),
            wipe,
        ));
    }
    let dead = survey.dead();
    if !dead.is_empty() {
        let names: Vec<String> = dead.iter().map(|one| told(one)).collect();
        lines.push(Line::note(
            ABOUT,
            format!("{} processes ended without signing off: {}", dead.len(), names.join(", ")),
            "the next start cleans up after them; if it does not, `noctule wipe`",
        ));
    }
    // The transport's own management file stays for ever.
    if !survey.is_inhabited() && survey.file_count > 1 && lines.len() == before {
        lines.push(Line::note(
            ABOUT,
            format!("{} files of stopped processes", survey.file_count),
            "the next start cleans up after them; if it does not, `noctule wipe`",
        ));
    }
    if lines.len() == before {
        lines.push(Line::ok(ABOUT, "none"));
    }
}

fn versions(survey: &Survey, lines: &mut Vec<Line>) {
    const ABOUT: &str = "versions";
    let before = lines.len();
    if let Some((path, version)) = survey.other_versions.first() {
        lines.push(Line::problem(
            ABOUT,
            format!(
                "{} files in shared memory were made by iceoryx2 {version}, this build speaks {TRANSPORT_VERSION}: {}",
                survey.other_versions.len(),
                path.display()
            ),
            format!("stop who made them, give all clients iceoryx2 {TRANSPORT_VERSION}, then `noctule wipe`"),
        ));
    }
    for service in survey.other_builds() {
        let users: Vec<String> = service.participants.iter().filter(|one| one.alive).map(told).collect();
        lines.push(Line::problem(
            ABOUT,
            format!(
                "{} has schema {}, this build expects {}; used by {}",
                service.name,
                service.schema.as_deref().unwrap_or("none"),
                service.expected.as_deref().unwrap_or("none"),
                if users.is_empty() { "nobody alive".to_owned() } else { users.join(", ") }
            ),
            "run daemon, controller and clients of one build; `noctule topics --json` tells clients the schema",
        ));
    }
    if lines.len() == before {
        let services = survey.services.as_ref().map_or(0, Vec::len);
        lines.push(Line::ok(
            ABOUT,
            format!("iceoryx2 {TRANSPORT_VERSION}; {services} services, all of this build's types"),
        ));
    }
}

/// The Python client's transport, as the first `python3` on the path has it.
fn python() -> Line {
    const ABOUT: &str = "python client";
    let install = format!("only for clients in Python: pip install iceoryx2=={TRANSPORT_VERSION}");
    match python_version() {
        None => Line::note(ABOUT, "python3 was not found or did not answer", install),
        Some(version) if version.is_empty() => Line::note(ABOUT, "python3 has no package iceoryx2", install),
        Some(version) if version == TRANSPORT_VERSION => Line::ok(ABOUT, format!("python3 has iceoryx2 {version}")),
        Some(version) => Line::problem(
            ABOUT,
            format!("python3 has iceoryx2 {version}, only {TRANSPORT_VERSION} is understood"),
            format!("pip install iceoryx2=={TRANSPORT_VERSION}"),
        ),
    }
}

/// Version of the package; empty without the package, none without Python.
fn python_version() -> Option<String> {
    let script =
        "import importlib.metadata as m\ntry: print(m.version('iceoryx2'))\nexcept m.PackageNotFoundError: print()";
    let mut child = Command::new("python3")
        .args(["-c", script])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .ok()?;
    let deadline = Instant::now() + PYTHON_LIMIT;
    loop {
        match child.try_wait() {
            Ok(Some(status)) if status.success() => break,
            Ok(None) if Instant::now() < deadline => std::thread::sleep(Duration::from_millis(10)),
            _ => {
                let _ = child.kill();
                let _ = child.wait();
                return None;
            }
        }
    }
    let output = child.wait_with_output().ok()?;
    Some(String::from_utf8_lossy(&output.stdout).trim().to_owned())
}
