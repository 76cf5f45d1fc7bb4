//! Who may look: token and session, compared in constant time; the Host against DNS rebinding, the Origin against sockets
//! that another site's page opens.
//!
//! Goes in: where the page listens, the token, a request's headers and query. Comes out: whether it may pass, and how to answer
//! where not. The session that a cookie carries is not the token, and ends with the process.

use axum::http::{HeaderMap, StatusCode, header};
use std::net::{IpAddr, SocketAddr};
use subtle::ConstantTimeEq as _;

/// Shortest token that is taken.
pub const TOKEN_MIN: usize = 16;
/// Longest token that is taken.
pub const TOKEN_MAX: usize = 256;
/// Bytes of randomness in what is generated.
const RANDOM_BYTES: usize = 16;

/// A secret that cannot be used.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum TokenError {
    /// Another length, or characters that a URL would change.
    #[error(
        "--token: found {found} characters{odd}, allowed: {TOKEN_MIN} to {TOKEN_MAX} of A-Z a-z 0-9 - _ . ~; without --token one is made"
    )]
    Unfit {
        /// Length.
        found: usize,
        /// What is odd about it.
        odd: &'static str,
    },
    /// The system has no randomness.
    #[error("the system gives no randomness for a token: {0}")]
    NoRandomness(String),
}

/// Judges a token that somebody chose.
///
/// # Errors
/// [`TokenError::Unfit`].
pub fn check_token(token: &str) -> Result<(), TokenError> {
    let fit = token.chars().all(|c| c.is_ascii_alphanumeric() || "-_.~".contains(c));
    if fit && (TOKEN_MIN..=TOKEN_MAX).contains(&token.len()) {
        return Ok(());
    }
    Err(TokenError::Unfit { found: token.chars().count(), odd: if fit { "" } else { ", some of them others" } })
}

/// Makes a secret of 128 random bits in hexadecimal digits.
///
/// # Errors
/// [`TokenError::NoRandomness`].
pub fn random_secret() -> Result<String, TokenError> {
    let mut bytes = [0u8; RANDOM_BYTES];
    let got = rustix::rand::getrandom(&mut bytes, rustix::rand::GetRandomFlags::empty());
    match got {
        Ok(RANDOM_BYTES) => Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect()),
        Ok(count) => Err(TokenError::NoRandomness(format!("{count} bytes"))),
        Err(error) => Err(TokenError::NoRandomness(error.to_string())),
    }
}

/// What a request is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Purpose {
    /// The page, its files and its numbers.
    Read,
    /// The page's own socket.
    PageSocket,
    /// A socket that programs other than the page open.
    PlayerSocket,
}

/// What happens to a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// It may pass.
    Pass,
    /// It may pass and brought the token in its query: give it a session, and an address without the token.
    PassAndRemember,
    /// It may not.
    Refuse(StatusCode, &'static str),
}

/// The rules.
#[derive(Debug, Clone)]
pub struct Access {
    token: Option<String>,
    session: String,
    cookie: String,
    loopback: bool,
    origins: Vec<String>,
}

impl Access {
    /// Rules of a page at `address`. `origins` are pages of other sites that may open player sockets.
    ///
    /// # Errors
    /// [`TokenError`].
    pub fn new(address: SocketAddr, token: Option<String>, origins: Vec<String>) -> Result<Self, TokenError> {
        let loopback = address.ip().is_loopback();
        let token = match token {
            Some(token) => {
                check_token(&token)?;
                Some(token)
            }
            None if loopback => None,
            None => Some(random_secret()?),
        };
        let cookie = format!("noctule_view_{}", address.port());
        let origins = origins.iter().map(|origin| origin.trim_end_matches('/').to_ascii_lowercase()).collect();
        Ok(Self { token, session: random_secret()?, cookie, loopback, origins })
    }

    /// The token that is asked for, if one is.
    #[must_use]
    pub fn token(&self) -> Option<&str> {
        self.token.as_deref()
    }

    /// The cookie of a session.
    #[must_use]
    pub fn set_cookie(&self) -> String {
        format!("{}={}; Path=/; HttpOnly; SameSite=Strict", self.cookie, self.session)
    }

    /// Judges a request by its headers and its query.
    #[must_use]
    pub fn judge(&self, headers: &HeaderMap, query: Option<&str>, purpose: Purpose) -> Verdict {
        if !self.host_fits(headers) {
            return Verdict::Refuse(
                StatusCode::MISDIRECTED_REQUEST,
                "this page answers to the names of this machine's loopback only",
            );
        }
        if purpose != Purpose::Read && !self.origin_fits(headers, purpose) {
            return Verdict::Refuse(StatusCode::FORBIDDEN, "another site's page may not open this socket");
        }
        let Some(token) = &self.token else { return Verdict::Pass };
        let same = |given: &str, secret: &str| bool::from(given.as_bytes().ct_eq(secret.as_bytes()));
        let cookies = headers.get_all(header::COOKIE).iter().filter_map(|value| value.to_str().ok());
        let session = cookies
            .flat_map(|cookies| cookies.split(';'))
            .filter_map(|cookie| cookie.trim().split_once('='))
            .any(|(name, value)| name == self.cookie && same(value, &self.session));
        let bearer = text(headers, header::AUTHORIZATION).and_then(|value| {
            let (scheme, given) = value.split_once(' ')?;
            scheme.eq_ignore_ascii_case("bearer").then_some(given.trim())
        });
        let queried = query.into_iter().flat_map(|query| query.split('&')).find_map(|pair| pair.strip_prefix("token="));
        match () {
            () if queried.is_some_and(|given| same(given, token)) => Verdict::PassAndRemember,
            () if session || bearer.is_some_and(|given| same(given, token)) => Verdict::Pass,
            () => Verdict::Refuse(
                StatusCode::UNAUTHORIZED,
                "this page asks for its token: open the address that `noctule view` printed, or send `Authorization: Bearer TOKEN`",
            ),
        }
    }

    /// On loopback only names of the loopback are answered to: a name that an attacker's server resolves to 127.0.0.1 is not one.
    /// Elsewhere the token protects, which no cookie of another name carries.
    fn host_fits(&self, headers: &HeaderMap) -> bool {
        if !self.loopback {
            return true;
        }
        let mut hosts = headers.get_all(header::HOST).iter();
        let (Some(host), None) = (hosts.next(), hosts.next()) else { return false };
        host.to_str().is_ok_and(|host| is_loopback_name(name_of(host)))
    }

    /// Programs send no Origin; browsers do, and only for the page's own may they open a socket, or for those that were allowed.
    fn origin_fits(&self, headers: &HeaderMap, purpose: Purpose) -> bool {
        let mut origins = headers.get_all(header::ORIGIN).iter();
        let Some(origin) = origins.next() else { return true };
        let (Ok(origin), None) = (origin.to_str(), origins.next()) else { return false };
        let origin = origin.to_ascii_lowercase();
        let own = text(headers, header::HOST).is_some_and(|host| {
            let host = host.to_ascii_lowercase();
            origin == format!("http://{host}") || origin == format!("https://{host}")
        });
        // Desktop applications are pages of the file system.
        let player = purpose == Purpose::PlayerSocket && (origin == "file://" || self.origins.contains(&origin));
        own || player
    }
}

fn text(headers: &HeaderMap, name: header::HeaderName) -> Option<&str> {
    headers.get(name).and_then(|value| value.to_str().ok())
}

/// `[::1]:8765` is `::1`, `localhost:1` is `localhost`.
fn name_of(host: &str) -> &str {
    if let Some(rest) = host.strip_prefix('[') {
        return rest.split_once(']').map_or("", |(name, _)| name);
    }
    host.rsplit_once(':').map_or(host, |(name, _)| name)
}

fn is_loopback_name(name: &str) -> bool {
    name.eq_ignore_ascii_case("localhost") || name.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;

    const TOKEN: &str = "0123456789abcdefXYZ";

    fn headers(pairs: &[(&'static str, &str)]) -> HeaderMap {
        pairs
            .iter()
            .map(|(name, value)| (name.parse().expect("name"), HeaderValue::from_str(value).expect("value")))
            .collect()
    }

    fn access(address: &str, token: Option<&str>) -> Access {
        let origins = vec!["https://app.foxglove.dev/".to_owned()];
        Access::new(address.parse().expect("address"), token.map(str::to_owned), origins).expect("access")
    }

    fn passes(access: &Access, pairs: &[(&'static str, &str)], query: Option<&str>, purpose: Purpose) -> bool {
        !matches!(access.judge(&headers(pairs), query, purpose), Verdict::Refuse(..))
    }

    #[test]
    fn on_loopback_only_the_names_of_the_loopback_are_answered() {
        let access = access("127.0.0.1:8765", None);
        for host in ["localhost:8765", "127.0.0.1:8765", "[::1]:8765", "LOCALHOST", "127.0.0.1:9"] {
            assert!(passes(&access, &[("host", host)], None, Purpose::Read), "{host}");
        }
        for host in [
            "evil.example:8765",
            "localhost.evil.example",
            "192.168.0.2:8765",
            "127.0.0.1.evil.example",
            "",
            "[",
            "a:b:c",
        ] {
            assert!(!passes(&access, &[("host", host)], None, Purpose::Read), "{host}");
        }
        assert!(!passes(&access, &[], None, Purpose::Read), "no Host");
        assert!(
            !passes(&access, &[("host", "localhost"), ("host", "evil.example")], None, Purpose::Read),
            "two of them"
        );
    }

    #[test]
    fn sockets_are_for_the_pages_own_origin_for_programs_and_for_allowed_players() {
        let access = access("127.0.0.1:8765", None);
        let host = ("host", "localhost:8765");
        let with = |origin, purpose| passes(&access, &[host, ("origin", origin)], None, purpose);
        for purpose in [Purpose::PageSocket, Purpose::PlayerSocket] {
            assert!(passes(&access, &[host], None, purpose));
            assert!(with("http://localhost:8765", purpose));
            for origin in ["http://evil.example", "null", "http://localhost:8766", "http://127.0.0.1:8765"] {
                assert!(!with(origin, purpose), "{origin}");
            }
        }
        assert!(with("https://app.foxglove.dev", Purpose::PlayerSocket) && with("file://", Purpose::PlayerSocket));
        assert!(!with("https://app.foxglove.dev", Purpose::PageSocket) && !with("file://", Purpose::PageSocket));
    }

    #[test]
    fn elsewhere_there_is_always_a_token_and_a_wrong_one_never_passes() {
        let made = access("0.0.0.0:8765", None);
        assert_eq!(made.token().map(str::len), Some(32));
        assert_ne!(made.token(), access("0.0.0.0:8765", None).token(), "another each time");
        let access = access("0.0.0.0:8765", Some(TOKEN));
        let host = ("host", "robot.local:8765");
        assert!(!passes(&access, &[host], None, Purpose::Read));
        assert_eq!(
            access.judge(&headers(&[host]), Some(&format!("a=b&token={TOKEN}")), Purpose::Read),
            Verdict::PassAndRemember
        );
        assert!(passes(&access, &[host, ("authorization", &format!("bearer {TOKEN}"))], None, Purpose::Read));
        let cookie = access.set_cookie();
        let cookie = cookie.split(';').next().expect("pair");
        assert!(passes(&access, &[host, ("cookie", &format!("x=y; {cookie}"))], None, Purpose::PageSocket));
        assert!(!cookie.contains(TOKEN), "the cookie does not carry the token");
        for wrong in ["", "0", &TOKEN[..TOKEN.len() - 1], "0123456789abcdefXYz", &format!("{TOKEN}0")] {
            assert!(!passes(&access, &[host], Some(&format!("token={wrong}")), Purpose::Read), "{wrong}");
            assert!(!passes(&access, &[host, ("authorization", &format!("Bearer {wrong}"))], None, Purpose::Read));
            assert!(!passes(&access, &[host, ("cookie", &format!("noctule_view_8765={wrong}"))], None, Purpose::Read));
        }
    }

    #[test]
    fn a_token_that_a_url_would_change_or_that_is_short_is_refused() {
        for token in ["short", "0123456789abcde", "0123456789 abcdef", "0123456789abcdef&x", "0123456789abcdefé"] {
            let error = check_token(token).expect_err(token);
            assert!(error.to_string().contains("allowed: 16 to 256"), "{error}");
        }
    }
}
