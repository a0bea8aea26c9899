//! Why a service cannot be offered.

/// Why a service or its topic could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum ServiceError {
    #[error("service name `{name}`: {problem}; expected an absolute name, as in /stage/reset")]
    Name { name: String, problem: String },
    #[error("cannot open `{name}`: {problem}")]
    Create { name: String, problem: String },
}

impl ServiceError {
    /// What the library says when it does not create `name`.
    pub(super) fn creating<E: std::fmt::Display>(name: &str) -> impl FnOnce(E) -> ServiceError {
        let name = name.to_owned();
        move |source| ServiceError::Create { name, problem: source.to_string() }
    }
}
