//! The page: one file for the browser, of several here.

use crate::secret;

/// The page, and the policy that lets exactly its own script and style run.
pub(crate) fn page() -> (String, String) {
    let nonce = secret::unpredictable();
    let script = format!("\"use strict\";\n{}", SCRIPTS.concat());
    let page = FRAME.replace("@NONCE@", &nonce).replace("@STYLE@", STYLE).replace("@SCRIPT@", &script);
    let policy = format!(
        "default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; connect-src 'self'; \
         img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    );
    (page, policy)
}

const FRAME: &str = include_str!("../assets/page.html");
const STYLE: &str = include_str!("../assets/page.css");
/// In the order in which they run.
const SCRIPTS: [&str; 9] = [
    include_str!("../assets/basics.js"),
    include_str!("../assets/store.js"),
    include_str!("../assets/map.js"),
    include_str!("../assets/timeline.js"),
    include_str!("../assets/ways.js"),
    include_str!("../assets/tables.js"),
    include_str!("../assets/feed.js"),
    include_str!("../assets/plot.js"),
    include_str!("../assets/main.js"),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_needs_nothing_from_elsewhere() {
        let (page, policy) = page();
        // The name space of SVG is a name, not a place.
        let without_names = page.replace("http://www.w3.org/2000/svg", "");
        for place in ["http://", "https://", "//cdn", "@import", "url(", "@NONCE@", "@STYLE@", "@SCRIPT@"] {
            assert!(!without_names.contains(place), "{place}");
        }
        assert!(page.contains("<script nonce=") && policy.contains("default-src 'none'"));
        for unsafe_thing in [" style=\"", "innerHTML", "eval(", " onclick="] {
            assert!(!page.contains(unsafe_thing), "{unsafe_thing}");
        }
    }

    #[test]
    fn each_page_has_a_policy_of_its_own() {
        assert_ne!(page().1, page().1);
    }
}
