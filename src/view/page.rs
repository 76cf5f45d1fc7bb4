//! The page's files, which are part of the program, and its socket.
//!
//! Goes in: moments. Comes out: for each that a browser is ready for, the energyscapes that it has not got as binary messages, then
//! the state as JSON. A browser says `ok` to each state; while it owes more than one it is sent nothing, and then gets the newest:
//! what it missed in between is never sent. Nothing that it says has another effect.

use super::board::{Moment, Point, Seat};
use super::server::Shared;
use super::state::state_json;
use axum::extract::State;
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde_json::json;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::{sleep, timeout};

/// Pages that may be open at a time.
const PAGES_MAX: usize = 8;
/// States that a browser may owe an `ok`.
const OWED_MAX: u32 = 2;
/// Time for one message to leave.
const SEND_LIMIT: Duration = Duration::from_secs(5);
/// A browser that says nothing for so long is gone.
const SILENCE_LIMIT: Duration = Duration::from_secs(20);
/// Longest word of a browser.
const WORD_BYTES: usize = 64;

/// A file of the page.
pub(super) struct Asset {
    pub(super) path: &'static str,
    kind: &'static str,
    content: &'static str,
}

impl Asset {
    pub(super) fn response(&self) -> Response {
        ([(header::CONTENT_TYPE, self.kind)], self.content).into_response()
    }
}

const JAVASCRIPT: &str = "text/javascript; charset=utf-8";
const INDEX: Asset = Asset { path: "/", kind: "text/html; charset=utf-8", content: include_str!("assets/index.html") };
/// All of them but the first.
pub(super) const ASSETS: [Asset; 7] = [
    Asset { path: "/style.css", kind: "text/css; charset=utf-8", content: include_str!("assets/style.css") },
    Asset { path: "/app.js", kind: JAVASCRIPT, content: include_str!("assets/app.js") },
    Asset { path: "/link.js", kind: JAVASCRIPT, content: include_str!("assets/link.js") },
    Asset { path: "/scape.js", kind: JAVASCRIPT, content: include_str!("assets/scape.js") },
    Asset { path: "/plan.js", kind: JAVASCRIPT, content: include_str!("assets/plan.js") },
    Asset { path: "/curves.js", kind: JAVASCRIPT, content: include_str!("assets/curves.js") },
    Asset { path: "/icon.svg", kind: "image/svg+xml", content: include_str!("assets/icon.svg") },
];

/// The page; for a player that asks to upgrade, its socket.
pub(super) async fn index(
    State(shared): State<Arc<Shared>>,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Response {
    match upgrade {
        Ok(upgrade) => super::foxglove::accept(shared, upgrade),
        Err(_) => INDEX.response(),
    }
}

/// The page's socket.
pub(super) async fn live(
    State(shared): State<Arc<Shared>>,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Response {
    let upgrade = match upgrade {
        Ok(upgrade) => upgrade,
        Err(rejection) => return rejection.into_response(),
    };
    let Some(seat) = shared.audience.page(PAGES_MAX) else {
        return (StatusCode::SERVICE_UNAVAILABLE, format!("{PAGES_MAX} pages are open already\n")).into_response();
    };
    let upgrade = upgrade.max_message_size(WORD_BYTES).max_frame_size(WORD_BYTES).write_buffer_size(0);
    upgrade.on_upgrade(move |socket| talk(socket, shared, seat))
}

async fn talk(mut socket: WebSocket, shared: Arc<Shared>, seat: Seat) {
    let mut moments = shared.reader.moments.clone();
    let mut sent = [0; crate::signal::SENSORS_MAX];
    let mut owed = 0;
    if send(&mut socket, Message::text(hello(&shared))).await.is_none() {
        return;
    }
    loop {
        tokio::select! {
            word = socket.recv() => match word {
                Some(Ok(Message::Text(word))) if word.as_str() == "ok" && owed > 0 => owed -= 1,
                Some(Ok(Message::Ping(_) | Message::Pong(_))) => {}
                // The end, an error, or a word that this page's browser never says.
                _ => break,
            },
            changed = moments.changed(), if owed < OWED_MAX => {
                if changed.is_err() {
                    break;
                }
                let moment = Arc::clone(&moments.borrow_and_update());
                if tell(&mut socket, &shared, &moment, &mut sent).await.is_none() {
                    break;
                }
                owed += 1;
            }
            () = sleep(SILENCE_LIMIT) => break,
        }
    }
    drop(seat);
}

/// What a page is told once.
fn hello(shared: &Shared) -> String {
    let now_ms = shared.reader.moments.borrow().made_ns as f64 * 1e-6;
    let history: Vec<Point> = shared.reader.history();
    json!({
        "kind": "hello",
        "version": env!("CARGO_PKG_VERSION"),
        "now_ms": now_ms,
        "robot": shared.robot.json(),
        "history": history,
    })
    .to_string()
}

/// A moment: the images that this browser has not got, then the state.
async fn tell(socket: &mut WebSocket, shared: &Shared, moment: &Moment, sent: &mut [u64]) -> Option<()> {
    for (image, sent) in moment.images.iter().zip(sent) {
        let Some(image) = image.as_ref().filter(|image| image.id != *sent) else { continue };
        if let Some(message) = &image.message {
            send(socket, Message::Binary(message.clone())).await?;
            *sent = image.id;
        }
    }
    send(socket, Message::text(state_json(moment, &shared.robot).to_string())).await
}

/// Sends within the limit; `None` when the connection is to be given up.
async fn send(socket: &mut WebSocket, message: Message) -> Option<()> {
    timeout(SEND_LIMIT, socket.send(message)).await.ok()?.ok()
}
