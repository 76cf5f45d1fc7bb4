//! The server: few connections, short requests, limited times, one thread. A connection that is slow or silent costs its own
//! place and nobody else's time.
//!
//! Goes in: the configuration and where to listen. Comes out: the page until it is asked to stop. Every request is judged by
//! [`Access`] before anything else is done with it.

use super::access::{Access, Purpose, TokenError, Verdict, random_secret};
use super::board::{Audience, Reader};
use super::listener::Listener;
use super::robot::Robot;
use super::{foxglove, metrics, page};
use crate::config::Config;
use crate::io::{Ipc, IpcError};
use crate::parameter::ParameterError;
use axum::Router;
use axum::extract::{Request, State};
use axum::http::{HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::sync::Semaphore;
use tokio::time::timeout;

/// Connections that are served at a time; further ones are closed.
const CONNECTIONS_MAX: usize = 48;
/// Time for the head of a request, and of silence between two.
const HEAD_LIMIT: Duration = Duration::from_secs(5);
/// Time for all requests of a connection that opens no socket.
const CONNECTION_LIMIT: Duration = Duration::from_secs(60);
/// Bytes of a request's head.
const HEAD_BYTES: usize = 16 * 1024;
/// Headers of a request.
const HEADERS_MAX: usize = 64;
/// Longest time until a wish to stop is seen.
const STOP_PAUSE: Duration = Duration::from_millis(100);
/// Time that open sockets get at the end.
const END_LIMIT: Duration = Duration::from_millis(200);

/// What the page loads and opens is its own, and it is nobody's frame.
const SECURITY_HEADERS: [(HeaderName, &str); 7] = [
    (
        header::CONTENT_SECURITY_POLICY,
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; base-uri 'none'; \
         form-action 'none'; frame-ancestors 'none'",
    ),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::X_FRAME_OPTIONS, "DENY"),
    (header::REFERRER_POLICY, "no-referrer"),
    (header::CACHE_CONTROL, "no-store"),
    (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
    (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
];

/// Where and for whom.
#[derive(Debug, Clone)]
pub struct ViewOptions {
    /// Address and port; port 0 takes any free one.
    pub listen: SocketAddr,
    /// Take any free port where that one is in use.
    pub or_any_port: bool,
    /// Token that is asked for; elsewhere than on loopback one is made without it.
    pub token: Option<String>,
    /// Origins of other pages that may open a player's socket.
    pub origins: Vec<String>,
}

/// Why there is no page.
#[derive(Debug, thiserror::Error)]
pub enum ViewError {
    /// The address is in use or not this machine's.
    #[error("cannot listen on {address}: {source}; --listen {ip}:0 takes any free port", ip = .address.ip())]
    Address {
        /// The address.
        address: SocketAddr,
        /// What the system says.
        source: std::io::Error,
    },
    /// The token.
    #[error(transparent)]
    Token(#[from] TokenError),
    /// The configuration.
    #[error(transparent)]
    Parameter(#[from] ParameterError),
    /// The transport.
    #[error(transparent)]
    Ipc(#[from] IpcError),
    /// A thread or the runtime could not be started.
    #[error("the page cannot be served: {0}")]
    Runtime(#[from] std::io::Error),
}

/// What all connections share.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) access: Access,
    pub(super) robot: Arc<Robot>,
    pub(super) reader: Reader,
    pub(super) audience: Arc<Audience>,
    /// Tells players that another process serves them now.
    pub(super) session: String,
}

/// A page that listens and is not served yet.
pub struct ViewServer {
    socket: TcpListener,
    address: SocketAddr,
    listener: Listener,
    shared: Arc<Shared>,
}

impl ViewServer {
    /// Opens the port and reads what there is to know of the robot. Daemon and controller may start later.
    ///
    /// # Errors
    /// [`ViewError`].
    pub fn open(config: &Config, options: &ViewOptions) -> Result<Self, ViewError> {
        let robot = Arc::new(Robot::new(config)?);
        let ipc = Ipc::open(&config.ipc)?;
        let socket = bind(options)?;
        let address = socket.local_addr()?;
        socket.set_nonblocking(true)?;
        let access = Access::new(address, options.token.clone(), options.origins.clone())?;
        let audience = Arc::new(Audience::default());
        let listener = Listener::new(ipc, Arc::clone(&robot), Arc::clone(&audience));
        let reader = listener.board.reader();
        let shared = Arc::new(Shared { access, robot, reader, audience, session: random_secret()? });
        Ok(Self { socket, address, listener, shared })
    }

    /// Where it listens.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What to open in a browser, with the token where one is asked for.
    #[must_use]
    pub fn url(&self) -> String {
        let address = match self.address.ip() {
            // No browser opens "every address"; this machine's own name for itself is one of them.
            ip if ip.is_unspecified() => format!("{}:{}", host_name(), self.address.port()),
            _ => self.address.to_string(),
        };
        let token = self.shared.access.token().map_or(String::new(), |token| format!("?token={token}"));
        format!("http://{address}/{token}")
    }

    /// Serves until `stop`.
    ///
    /// # Errors
    /// [`ViewError::Runtime`].
    pub fn serve(self, stop: &Arc<AtomicBool>) -> Result<(), ViewError> {
        let Self { socket, listener, shared, .. } = self;
        let asked = Arc::clone(stop);
        let listening =
            std::thread::Builder::new().name("noctule-view listen".to_owned()).spawn(move || listener.run(&asked))?;
        let runtime = tokio::runtime::Builder::new_current_thread().enable_io().enable_time().build()?;
        let served = runtime.block_on(async {
            let socket = tokio::net::TcpListener::from_std(socket)?;
            accept(&socket, &router(&shared), stop).await;
            Ok(())
        });
        runtime.shutdown_timeout(END_LIMIT);
        stop.store(true, Ordering::Relaxed);
        // It sees the flag within a pause, or hangs in the transport, which must not keep the process.
        for _ in 0..20 {
            if listening.is_finished() {
                break;
            }
            std::thread::sleep(STOP_PAUSE / 5);
        }
        served
    }
}

fn bind(options: &ViewOptions) -> Result<TcpListener, ViewError> {
    let address = options.listen;
    match TcpListener::bind(address) {
        Err(source) if options.or_any_port && source.kind() == std::io::ErrorKind::AddrInUse => {
            log::warn!("port {} is in use; the live page takes a free one", address.port());
            let any = SocketAddr::new(address.ip(), 0);
            TcpListener::bind(any).map_err(|source| ViewError::Address { address: any, source })
        }
        bound => bound.map_err(|source| ViewError::Address { address, source }),
    }
}

fn host_name() -> String {
    let uname = rustix::system::uname();
    let name = uname.nodename().to_string_lossy().into_owned();
    if name.is_empty() { "localhost".to_owned() } else { name }
}

fn router(shared: &Arc<Shared>) -> Router {
    let mut router = Router::new()
        .route("/", get(page::index))
        .route("/live", get(page::live))
        .route("/foxglove", get(foxglove::player))
        .route("/metrics", get(metrics::metrics))
        .route("/healthz", get(metrics::healthz));
    for asset in &page::ASSETS {
        router = router.route(asset.path, get(move || async move { asset.response() }));
    }
    router.layer(from_fn_with_state(Arc::clone(shared), guard)).with_state(Arc::clone(shared))
}

/// Judges every request first, and gives every answer its headers.
async fn guard(State(shared): State<Arc<Shared>>, request: Request, next: Next) -> Response {
    let upgrades = request.headers().contains_key(header::UPGRADE);
    let (uri, method) = (request.uri(), request.method());
    let purpose = match (upgrades, uri.path()) {
        (true, "/live") => Purpose::PageSocket,
        (true, _) => Purpose::PlayerSocket,
        (false, _) => Purpose::Read,
    };
    let open = uri.path() == "/healthz";
    let mut response = match shared.access.judge(request.headers(), uri.query(), purpose) {
        _ if method != Method::GET && method != Method::HEAD => {
            (StatusCode::METHOD_NOT_ALLOWED, [(header::ALLOW, "GET, HEAD")], "this page is for looking only\n")
                .into_response()
        }
        Verdict::Refuse(StatusCode::UNAUTHORIZED, _) if open => next.run(request).await,
        Verdict::Refuse(status, why) => (status, format!("{why}\n")).into_response(),
        Verdict::PassAndRemember if uri.path() == "/" && !upgrades => {
            let cookie = shared.access.set_cookie();
            // The address that stays in the browser's history does not hold the token.
            (StatusCode::SEE_OTHER, [(header::LOCATION, "/".to_owned()), (header::SET_COOKIE, cookie)]).into_response()
        }
        Verdict::Pass | Verdict::PassAndRemember => next.run(request).await,
    };
    for (name, value) in SECURITY_HEADERS {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    response
}

async fn accept(socket: &tokio::net::TcpListener, router: &Router, stop: &AtomicBool) {
    let places = Arc::new(Semaphore::new(CONNECTIONS_MAX));
    while !stop.load(Ordering::Relaxed) {
        let stream = match timeout(STOP_PAUSE, socket.accept()).await {
            Err(_) => continue,
            Ok(Ok((stream, _))) => stream,
            Ok(Err(error)) => {
                // Too many open files, mostly: later there may be fewer.
                log::debug!("a connection could not be taken: {error}");
                tokio::time::sleep(STOP_PAUSE).await;
                continue;
            }
        };
        let Ok(place) = Arc::clone(&places).try_acquire_owned() else { continue };
        let _ = stream.set_nodelay(true);
        let service = TowerToHyperService::new(router.clone());
        tokio::spawn(async move {
            let mut builder = http1::Builder::new();
            builder.timer(TokioTimer::new()).header_read_timeout(HEAD_LIMIT);
            builder.max_buf_size(HEAD_BYTES).max_headers(HEADERS_MAX);
            let connection = builder.serve_connection(TokioIo::new(stream), service).with_upgrades();
            let _ = timeout(CONNECTION_LIMIT, connection).await;
            drop(place);
        });
    }
}
