//! Publishing by the page, for those who were given the token.

use std::fmt;
use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::secret;

/// What whoever publishes must have: 128 random bits.
#[derive(Clone, PartialEq, Eq)]
pub struct Token(String);

impl Token {
    /// A new one.
    ///
    /// # Panics
    /// The system gives no random bytes.
    pub fn draw() -> Self {
        Self(secret::unpredictable())
    }

    /// Its digits, to show them to who started the server.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// Takes as long for a wrong guess as for a good one of the same length.
    pub(crate) fn is(&self, given: &str) -> bool {
        let differing =
            self.0.bytes().zip(given.bytes()).fold(0, |found, (one, other)| found | (one ^ other));
        given.len() == self.0.len() && differing == 0
    }
}

/// Does not show it: logs are read by others.
impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(..)")
    }
}

/// An event that a browser wants published.
#[derive(Clone, PartialEq, Eq, Deserialize, Debug)]
#[serde(deny_unknown_fields)]
pub struct PublishRequest {
    /// The number of the segment, in the order in which the hub got them.
    pub segment: usize,
    /// The channel, by its name in the plan or by its subject.
    pub channel: String,
    /// The content as words: `field=value` for each field, or hexadecimal digits.
    pub content: Vec<String>,
}

/// What became of it.
#[derive(Clone, PartialEq, Eq, Serialize, Debug)]
pub struct Answer {
    /// Whether it was published.
    pub published: bool,
    /// Why not, and what to do.
    pub why: Option<String>,
}

type Publish =
    dyn Fn(PublishRequest) -> Pin<Box<dyn Future<Output = Result<(), String>> + Send>> + Send + Sync;

/// How events are published, and who may.
#[derive(Clone)]
pub struct Publishing {
    pub(crate) token: Token,
    publish: Arc<Publish>,
}

impl Publishing {
    /// Whoever has the token may publish, by this function: it answers when the event has been published, or why not.
    pub fn new<F>(token: Token, publish: impl Fn(PublishRequest) -> F + Send + Sync + 'static) -> Self
    where
        F: Future<Output = Result<(), String>> + Send + 'static,
    {
        Self { token, publish: Arc::new(move |request| Box::pin(publish(request))) }
    }

    pub(crate) async fn publish(&self, request: PublishRequest) -> Result<(), String> {
        (self.publish)(request).await
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_token_is_the_token() {
        let token = Token::draw();
        assert!(token.is(token.as_str()));
        let mut near = token.as_str().to_owned();
        near.pop();
        for wrong in [near.as_str(), "", &format!("{near}x"), &format!("{}0", token.as_str())] {
            assert!(!token.is(wrong), "{wrong}");
        }
        assert!(!format!("{token:?}").contains(token.as_str()));
    }
}
