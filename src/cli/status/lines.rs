//! A look as lines for people and as JSON for programs.

use super::Look;
use super::advice::{self, Finding};
use crate::calibration::Alarms;
use crate::io::wire::message::{backend_name, layer_name};
use crate::sensor::air;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// Width of the first column.
const WIDTH: usize = 12;

fn line(text: &mut String, about: &str, told: &str) {
    let _ = writeln!(text, "{about:WIDTH$} {told}");
}

/// A number for people, a dash for none.
fn number(value: f64, decimals: usize) -> String {
    if value.is_finite() { format!("{value:.decimals$}") } else { "-".to_owned() }
}

impl Look<'_> {
    pub(super) fn text(&self, findings: &[Finding]) -> String {
        let mut text = String::new();
        line(&mut text, "daemon", &self.daemon_line());
        line(&mut text, "controller", &self.controller_line());
        line(&mut text, "motion", &advice::motion(self));
        if let Some(decision) = self.decision() {
            line(&mut text, "decision", &decision);
        }
        self.health_lines(&mut text);
        for (service, publishers) in self.publishers() {
            line(&mut text, "publisher", &format!("{service}: {publishers}"));
        }
        let place = format!("{}, prefix {}", self.survey.root_path.display(), self.survey.prefix);
        line(&mut text, "place", &place);
        for finding in findings {
            line(&mut text, "FINDING", &finding.found);
            line(&mut text, "", &format!("-> {}", finding.remedy));
        }
        if findings.is_empty() {
            line(&mut text, "all is well", "");
        }
        text
    }

    fn daemon_line(&self) -> String {
        let process = self.survey.daemon.map_or("no lock held".to_owned(), |process| format!("process {process}"));
        let Some((state, reason)) = self.daemon() else { return format!("not heard; {process}") };
        let (epoch, heard_ns) = match (self.heard.command, self.heard.health) {
            (Some(command), _) => (command.epoch, command.t_published_ns),
            (None, Some(health)) => (health.epoch, health.t_monotonic_ns),
            (None, None) => (0, 0),
        };
        format!("{state} ({reason}), {process}, heard {} s ago, epoch {epoch:016x}", number(self.age_s(heard_ns), 2))
    }

    fn controller_line(&self) -> String {
        let (Some(platform), Some((state, reason))) = (self.heard.platform, self.controller()) else {
            return "not heard".to_owned();
        };
        let armed = match (platform.epoch, self.heard.command.map(|command| command.epoch)) {
            (0, _) => "not armed",
            (armed, Some(running)) if armed == running => "armed",
            _ => "armed for another start of the daemon",
        };
        format!(
            "{state} ({reason}), heard {} s ago, {armed}, {} of {} commands followed, {} refused",
            number(self.age_s(platform.t_monotonic_ns), 2),
            platform.accepted_count,
            platform.received_count,
            platform.refused_count
        )
    }

    /// The newest decision: layer, cause and what it compared.
    fn decision(&self) -> Option<String> {
        let command = self.heard.command?;
        let layer = layer_name(command.layer).unwrap_or("unknown layer").replace('_', " ");
        let asked = format!("{:.2} m/s, {:.2} rad/s", command.linear_m_s, command.angular_rad_s);
        let age = number(self.age_s(command.t_monotonic_ns) * 1e3, 0);
        let cause = match self.sensor_name(command.cause_sensor) {
            Some(sensor) => format!(
                "; {sensor} hears {} m away at {} deg {:.4} over {:.4}",
                number(command.cause_range_m, 2),
                number(command.cause_bearing_rad.to_degrees(), 0),
                command.cause_energy,
                command.cause_threshold
            ),
            None => String::new(),
        };
        Some(format!("{layer}: {asked}{cause}; from an emission {age} ms ago"))
    }

    fn health_lines(&self, text: &mut String) {
        let Some(health) = self.heard.health else {
            line(text, "health", "not heard");
            return;
        };
        let rate = self.ping_rate_hz().map_or("-".to_owned(), |rate_hz| number(rate_hz, 1));
        let counts = format!(
            "{rate} sets a second, {} imaged, {} dropped, {} late, {} stops",
            health.ping_set_count, health.dropped_count, health.late_count, health.stop_count
        );
        line(text, "pings", &counts);
        let [newest, p50, p99, max] =
            [health.latency_ms, health.latency_p50_ms, health.latency_p99_ms, health.latency_max_ms]
                .map(|milliseconds| number(milliseconds, 1));
        line(text, "latency", &format!("{newest} ms; p50 {p50}, p99 {p99}, largest {max} (last sample to command)"));
        for (index, sensor) in self.config.sensor.iter().enumerate() {
            let delivers = if health.delivers(index) { "delivers" } else { "SILENT" };
            let told = format!(
                "{}: {delivers}, {} channels left out, {} pings rejected, {} gaps",
                sensor.name, health.bad_channel_count[index], health.rejected_count[index], health.gap_count[index]
            );
            line(text, "sensor", &told);
        }
        self.air_line(text);
        let backend = backend_name(health.backend).unwrap_or("?");
        let lost = match health.gpu_loss_count {
            0 => String::new(),
            count => format!(", GPU lost {count} times"),
        };
        line(text, "backend", &format!("{backend}, {}{lost}", health.adapter_name()));
    }

    /// What the direct paths tell of the air.
    fn air_line(&self, text: &mut String) {
        let Some(health) = self.heard.health.filter(|health| health.drift_looks > 0) else { return };
        let told = self.config.sensor.iter().zip(health.heard_speed_m_s).filter(|(_, speed_m_s)| *speed_m_s > 0.0);
        let told = told.map(|(sensor, speed_m_s)| {
            format!("{}: {speed_m_s:.1} m/s, {:.1} C", sensor.name, air::air_temperature_c(speed_m_s))
        });
        line(text, "air", &format!("as the sensors hear it: {}", told.collect::<Vec<_>>().join("; ")));
    }

    fn sensors_json(&self) -> Vec<Value> {
        let health = self.heard.health;
        self.config
            .sensor
            .iter()
            .enumerate()
            .map(|(index, sensor)| {
                json!({
                    "name": sensor.name,
                    "delivers": health.map(|health| health.delivers(index)),
                    "channels_left_out": health.map(|health| health.bad_channel_count[index]),
                    "pings_rejected": health.map(|health| health.rejected_count[index]),
                    "gaps": health.map(|health| health.gap_count[index]),
                    "heard_speed_m_s": health.map(|health| health.heard_speed_m_s[index]).filter(|speed_m_s| *speed_m_s > 0.0),
                    "drift": health.map(|health| Alarms::from_bits(health.drift[index]).to_string()),
                })
            })
            .collect()
    }

    pub(super) fn json(&self) -> Value {
        let health = self.heard.health;
        let command = self.heard.command;
        let services: Map<String, Value> = (self.survey.services.iter().flatten())
            .map(|service| (service.name.clone(), json!(service.participants)))
            .collect();
        json!({
            "root": self.survey.root_path,
            "prefix": self.survey.prefix,
            "daemon": self.daemon().map(|(state, reason)| json!({
                "state": state.as_str(),
                "reason": reason.as_str(),
                "process": self.survey.daemon,
                "epoch": command.map(|command| command.epoch).or(health.map(|health| health.epoch)),
                "command_age_s": command.map(|command| self.age_s(command.t_published_ns)),
                "health_age_s": health.map(|health| self.age_s(health.t_monotonic_ns)),
            })),
            "controller": self.heard.platform.zip(self.controller()).map(|(platform, (state, reason))| json!({
                "state": state.as_str(),
                "reason": reason.as_str(),
                "age_s": self.age_s(platform.t_monotonic_ns),
                "armed_epoch": platform.epoch,
                "linear_m_s": platform.linear_m_s,
                "angular_rad_s": platform.angular_rad_s,
                "received": platform.received_count,
                "followed": platform.accepted_count,
                "refused": platform.refused_count,
            })),
            "motion": advice::motion(self),
            "decision": command.map(|command| json!({
                "layer": layer_name(command.layer),
                "linear_m_s": command.linear_m_s,
                "angular_rad_s": command.angular_rad_s,
                "sensor": self.sensor_name(command.cause_sensor),
                "range_m": command.cause_range_m,
                "bearing_rad": command.cause_bearing_rad,
                "energy": command.cause_energy,
                "threshold": command.cause_threshold,
                "stuck": command.stuck != 0,
                "emission_age_s": self.age_s(command.t_monotonic_ns),
            })),
            "ping_rate_hz": self.ping_rate_hz(),
            "ping_sets": health.map(|health| health.ping_set_count),
            "dropped": health.map(|health| health.dropped_count),
            "late": health.map(|health| health.late_count),
            "stops": health.map(|health| health.stop_count),
            "gpu_losses": health.map(|health| health.gpu_loss_count),
            "latency_ms": health.map(|health| json!({
                "newest": health.latency_ms, "p50": health.latency_p50_ms, "p99": health.latency_p99_ms, "max": health.latency_max_ms,
            })),
            "sensors": self.sensors_json(),
            "backend": health.and_then(|health| backend_name(health.backend)),
            "adapter": health.map(|health| health.adapter_name()),
            "publishers": self.publishers.iter().cloned().collect::<BTreeMap<String, Vec<u32>>>(),
            "services": services,
        })
    }
}
