//! A bucket of an S3-like store.
//! `rusty_s3` signs requests and `ureq` sends them. An error of the store becomes one line.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD as BASE64;
use rtec_records::spool::RecordStore;
use rusty_s3::{Bucket, Credentials, S3Action, UrlStyle};
use sha2::{Digest, Sha256};
use std::io;
use std::time::Duration;
use ureq::http::{Response, StatusCode};
use ureq::tls::{Certificate, PemItem, RootCerts, TlsConfig, parse_pem};
use ureq::{Agent, Body};

/// Validity of a signed request.
const SIGNED_FOR: Duration = Duration::from_secs(3600);
/// Silence after which the store counts as gone.
const SILENT: Duration = Duration::from_secs(30);
/// Largest size of one PUT, and so of a file that is read back, bytes.
const LARGEST: u64 = 5 << 30;

/// The store's address, from the command line and the environment.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Address {
    bucket: String,
    /// Empty, or ends with `/`.
    prefix: String,
    endpoint: String,
    region: String,
    own_endpoint: bool,
}

impl Address {
    /// Parses `s3://BUCKET/PREFIX`; endpoint and region come from the usual variables.
    pub(crate) fn parse(
        to: &str,
        endpoint: Option<&str>,
        env: impl Fn(&str) -> Option<String>,
    ) -> Result<Self, String> {
        let expected =
            "expected s3://BUCKET or s3://BUCKET/FOLDER; a bucket has 3 to 63 of a-z, 0-9, `.` and `-`";
        let rest = to.strip_prefix("s3://").ok_or_else(|| format!("--to: found `{to}`, {expected}"))?;
        let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
        let letter = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || ".-".contains(c);
        if !(3..=63).contains(&bucket.len()) || !bucket.chars().all(letter) {
            return Err(format!("--to: found the bucket `{bucket}`, {expected}"));
        }
        let prefix = prefix.trim_matches('/');
        let set = |names: &[&str]| names.iter().find_map(|n| env(n).filter(|v| !v.is_empty()));
        let own = endpoint
            .map(str::to_owned)
            .or_else(|| set(&["AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL", "AWS_ENDPOINT"]));
        let region = set(&["AWS_REGION", "AWS_DEFAULT_REGION"]);
        let (endpoint, region) = match (&own, region) {
            (Some(own), region) => (own.clone(), region.unwrap_or_else(|| "us-east-1".to_owned())),
            (None, Some(region)) => (format!("https://s3.{region}.amazonaws.com"), region),
            (None, None) => {
                return Err("found neither an endpoint nor a region, expected --endpoint https://HOST of the plant's \
                    store, or AWS_REGION in the environment"
                    .to_owned());
            }
        };
        Ok(Self {
            bucket: bucket.to_owned(),
            prefix: if prefix.is_empty() { String::new() } else { format!("{prefix}/") },
            endpoint,
            region,
            own_endpoint: own.is_some(),
        })
    }
}

/// A bucket, ready to be written.
pub(crate) struct S3Bucket {
    bucket: Bucket,
    credentials: Credentials,
    prefix: String,
    agent: Agent,
}

impl S3Bucket {
    pub(crate) fn open(
        address: &Address,
        credentials: Credentials,
        roots: Option<RootCerts>,
    ) -> Result<Self, String> {
        let wrong = |what: &str| {
            format!(
                "the endpoint: found `{}`{what}, expected http://HOST:PORT or https://HOST",
                address.endpoint
            )
        };
        let mut url: url::Url = address.endpoint.parse().map_err(|e| wrong(&format!(" ({e})")))?;
        if !url.username().is_empty() || url.password().is_some() {
            return Err(
                "the endpoint: found a name or a password in it, expected them as AWS_ACCESS_KEY_ID and \
                AWS_SECRET_ACCESS_KEY in the environment"
                    .to_owned(),
            );
        }
        if url.query().is_some() || url.fragment().is_some() {
            return Err(wrong(""));
        }
        if !url.path().ends_with('/') {
            let path = format!("{}/", url.path());
            url.set_path(&path);
        }
        // Certificates cover one level of names. So a bucket with dots goes into the path, as at every store other than
        // Amazon's.
        let in_path = address.own_endpoint || address.bucket.contains('.');
        let style = if in_path { UrlStyle::Path } else { UrlStyle::VirtualHost };
        let bucket = Bucket::new(url, style, address.bucket.clone(), address.region.clone())
            .map_err(|e| wrong(&format!(" ({e})")))?;
        let mut config = Agent::config_builder()
            .http_status_as_error(false)
            .max_redirects(0)
            .max_redirects_will_error(false)
            .timeout_connect(Some(SILENT))
            .timeout_recv_response(Some(SILENT))
            .timeout_per_read(Some(SILENT))
            .timeout_per_write(Some(SILENT));
        if let Some(roots) = roots {
            config = config.tls_config(TlsConfig::builder().root_certs(roots).build());
        }
        Ok(Self { bucket, credentials, prefix: address.prefix.clone(), agent: config.build().new_agent() })
    }

    fn key(&self, key: &str) -> String {
        format!("{}{key}", self.prefix)
    }

    fn refused(&self, answer: &mut Response<Body>) -> io::Error {
        let status = answer.status();
        let text = answer.body_mut().with_config().limit(1 << 16).read_to_string().unwrap_or_default();
        refusal(status, &text, self.bucket.name())
    }
}

impl RecordStore for S3Bucket {
    fn put(&self, key: &str, bytes: &[u8]) -> io::Result<()> {
        let key = self.key(key);
        // The store computes the same sum over what it gets, and refuses anything that differs.
        let sum = BASE64.encode(Sha256::digest(bytes));
        let headers = [("x-amz-checksum-sha256", sum.as_str()), ("x-amz-sdk-checksum-algorithm", "SHA256")];
        let mut action = self.bucket.put_object(Some(&self.credentials), &key);
        for (name, value) in headers {
            action.headers_mut().insert(name, value);
        }
        let url = action.sign(SIGNED_FOR);
        let request =
            headers.iter().fold(self.agent.put(url.as_str()), |r, (name, value)| r.header(*name, *value));
        let mut answer = request.send(bytes).map_err(|e| away(&e))?;
        if !answer.status().is_success() {
            return Err(self.refused(&mut answer));
        }
        match answer.headers().get("x-amz-checksum-sha256").and_then(|v| v.to_str().ok()) {
            Some(theirs) if theirs != sum => {
                Err(io::Error::other(format!("the store's SHA-256 is {theirs}, that of what was sent {sum}")))
            }
            _ => Ok(()),
        }
    }

    fn get(&self, key: &str) -> io::Result<Option<Vec<u8>>> {
        let key = self.key(key);
        let url = self.bucket.get_object(Some(&self.credentials), &key).sign(SIGNED_FOR);
        let mut answer = self.agent.get(url.as_str()).call().map_err(|e| away(&e))?;
        if answer.status().is_success() {
            let bytes = answer.body_mut().with_config().limit(LARGEST).read_to_vec().map_err(|e| away(&e))?;
            return Ok(Some(bytes));
        }
        let missing = answer.status() == StatusCode::NOT_FOUND;
        let refused = self.refused(&mut answer);
        if missing && refused.kind() == io::ErrorKind::Other { Ok(None) } else { Err(refused) }
    }
}

/// Certificates of the plant's own authority, as PEM.
pub(crate) fn roots(pem: &[u8]) -> Result<RootCerts, String> {
    let found: Result<Vec<Certificate<'static>>, _> = parse_pem(pem)
        .filter_map(|item| match item {
            Ok(PemItem::Certificate(certificate)) => Some(Ok(certificate)),
            Ok(_) => None,
            Err(e) => Some(Err(e)),
        })
        .collect();
    match found {
        Ok(found) if !found.is_empty() => Ok(RootCerts::new_with_certs(&found)),
        Ok(_) => Err("found no certificate, expected some as PEM".to_owned()),
        Err(e) => Err(format!("found {e}, expected certificates as PEM")),
    }
}

/// Why there was no complete answer.
fn away(error: &ureq::Error) -> io::Error {
    match error {
        ureq::Error::Io(e) => io::Error::new(io::ErrorKind::ConnectionAborted, e.to_string()),
        other => io::Error::new(io::ErrorKind::ConnectionAborted, other.to_string()),
    }
}

/// A refusal of the store as an error of a kind.
/// The caller can correct `PermissionDenied`, `NotFound` and `InvalidInput`. All others may pass by the next try.
fn refusal(status: StatusCode, text: &str, bucket: &str) -> io::Error {
    use io::ErrorKind::{InvalidInput, NotFound, Other, PermissionDenied};
    let code = element(text, "Code");
    let (kind, mend) = match code.as_str() {
        "NoSuchBucket" => (NotFound, format!("make the bucket `{bucket}`, or name another with --to")),
        "InvalidAccessKeyId" | "SignatureDoesNotMatch" | "InvalidToken" | "ExpiredToken" => (
            PermissionDenied,
            "are AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY (and AWS_SESSION_TOKEN) those of this store?"
                .to_owned(),
        ),
        "RequestTimeTooSkewed" | "RequestExpired" => {
            (PermissionDenied, "is this computer's clock right?".to_owned())
        }
        "PermanentRedirect"
        | "TemporaryRedirect"
        | "AuthorizationHeaderMalformed"
        | "AuthorizationQueryParametersError"
        | "IllegalLocationConstraintException" => {
            (InvalidInput, "is AWS_REGION the region of this bucket?".to_owned())
        }
        "NoSuchKey" => (Other, String::new()),
        _ if status == StatusCode::FORBIDDEN => (
            PermissionDenied,
            "the key must be allowed s3:GetObject, s3:PutObject and s3:ListBucket of this bucket".to_owned(),
        ),
        _ if status.is_redirection() => (InvalidInput, "is this the endpoint of a store?".to_owned()),
        _ if status == StatusCode::BAD_REQUEST => (InvalidInput, String::new()),
        _ => (Other, String::new()),
    };
    let said = [code, element(text, "Message")];
    let said: Vec<&str> = said.iter().map(String::as_str).filter(|s| !s.is_empty()).collect();
    let mut line = format!("the answer {}", status.as_u16());
    for (part, before) in [(said.join(": "), " "), (mend, "; ")] {
        if !part.is_empty() {
            line += before;
            line += &part;
        }
    }
    io::Error::new(kind, line)
}

/// The text of the first element of this name, without control characters.
fn element(text: &str, name: &str) -> String {
    let (open, close) = (format!("<{name}>"), format!("</{name}>"));
    let inside =
        text.split_once(&open).and_then(|(_, rest)| rest.split_once(&close)).map_or("", |(inside, _)| inside);
    inside.chars().filter(|c| !c.is_control()).take(200).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn nothing(_: &str) -> Option<String> {
        None
    }

    #[test]
    fn where_to_is_said_by_the_command_line_or_the_environment() {
        let at = |to: &str, endpoint, name: &'static str, value: &'static str| {
            Address::parse(to, endpoint, move |n| (n == name).then(|| value.to_owned()))
        };
        let own = at("s3://plant/shop/7/", Some("http://127.0.0.1:9000"), "", "").unwrap();
        assert_eq!(
            (own.bucket.as_str(), own.prefix.as_str(), own.region.as_str()),
            ("plant", "shop/7/", "us-east-1")
        );
        assert!(own.own_endpoint);
        for name in ["AWS_ENDPOINT", "AWS_ENDPOINT_URL", "AWS_ENDPOINT_URL_S3"] {
            assert_eq!(at("s3://plant", None, name, "http://a").unwrap().endpoint, "http://a");
        }
        let amazon = at("s3://plant", None, "AWS_REGION", "eu-central-1").unwrap();
        assert_eq!(amazon.endpoint, "https://s3.eu-central-1.amazonaws.com");
        assert!(!amazon.own_endpoint);
        assert!(Address::parse("s3://plant", None, nothing).unwrap_err().contains("AWS_REGION"));
        for wrong in ["s3://", "s3:///x", "s3://Plant", "s3://a b", "gs://plant", "plant"] {
            let said = Address::parse(wrong, Some("http://a"), nothing).unwrap_err();
            assert!(said.contains("found") && said.contains("expected s3://BUCKET"), "{said}");
        }
    }

    #[test]
    fn an_endpoint_is_a_host_and_holds_no_password() {
        let opened = |endpoint: &str| {
            let address = Address::parse("s3://plant", Some(endpoint), nothing).unwrap();
            S3Bucket::open(&address, Credentials::new("key", "hush"), None)
                .map(|s| s.bucket.base_url().to_string())
        };
        assert_eq!(opened("http://127.0.0.1:9000").unwrap(), "http://127.0.0.1:9000/plant/");
        assert_eq!(opened("https://gateway/s3").unwrap(), "https://gateway/s3/plant/");
        assert!(!opened("http://name:hush@host").unwrap_err().contains("hush"));
        for wrong in ["", "host", "ftp://host", "http://", "http://host/?a=b"] {
            let said = opened(wrong).unwrap_err();
            assert!(said.contains("expected http://HOST:PORT"), "{wrong}: {said}");
        }
    }

    #[test]
    fn a_refusal_is_one_line_that_says_how_to_mend_it() {
        let said = |status: u16, text: &str| refusal(StatusCode::from_u16(status).unwrap(), text, "plant");
        let error = said(404, "<Error><Code>NoSuchBucket</Code><Message>not\nthere</Message></Error>");
        assert_eq!(error.kind(), io::ErrorKind::NotFound);
        assert_eq!(
            error.to_string(),
            "the answer 404 NoSuchBucket: notthere; make the bucket `plant`, or name another with --to"
        );
        assert_eq!(said(403, "<html>").kind(), io::ErrorKind::PermissionDenied);
        assert!(said(403, "<Code>RequestTimeTooSkewed</Code>").to_string().contains("clock"));
        assert!(said(301, "<Code>PermanentRedirect</Code>").to_string().contains("AWS_REGION"));
        for passing in [500, 503, 507, 429] {
            assert_eq!(said(passing, "").kind(), io::ErrorKind::Other, "{passing}");
        }
    }

    #[test]
    fn certificates_are_pem_or_refused() {
        assert!(roots(b"").unwrap_err().contains("no certificate"));
        assert!(roots(b"-----BEGIN CERTIFICATE-----\n!\n-----END CERTIFICATE-----\n").is_err());
    }
}
