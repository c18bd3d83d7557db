//! A TOML file being read: what will not do is said with the file, the line and the key.

use thiserror::Error;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// What is wrong with the content of a file of a motor or of effects.
#[derive(Debug, Error)]
pub enum FileError {
    /// Not TOML.
    #[error("motor file {file}, line {line}: {message}")]
    Syntax {
        /// The file.
        file: String,
        /// Line, from 1.
        line: usize,
        /// What the parser says.
        message: String,
    },
    /// A key with a value that will not do.
    #[error("motor file {file}, line {line}: `{key}` {problem}")]
    Key {
        /// The file.
        file: String,
        /// Line, from 1.
        line: usize,
        /// The key, with its table.
        key: String,
        /// What is wrong and what to do.
        problem: String,
    },
}

/// A file being read: what an error needs to point.
pub(crate) struct Reader<'a> {
    pub(crate) file: &'a str,
    pub(crate) text: &'a str,
}

pub(crate) type Table<'a> = Spanned<DeTable<'a>>;

impl<'a> Reader<'a> {
    pub(crate) fn root(&self) -> Result<Table<'a>, FileError> {
        DeTable::parse(self.text).map_err(|error| FileError::Syntax {
            file: self.file.into(),
            line: self.line(error.span().map_or(0, |span| span.start)),
            message: error.message().to_owned(),
        })
    }

    fn line(&self, offset: usize) -> usize {
        self.text.as_bytes().iter().take(offset).filter(|&&b| b == b'\n').count() + 1
    }

    pub(crate) fn key(&self, key: impl Into<String>, offset: usize, problem: impl Into<String>) -> FileError {
        FileError::Key { file: self.file.into(), line: self.line(offset), key: key.into(), problem: problem.into() }
    }

    pub(crate) fn number(&self, key: &str, value: &Spanned<DeValue<'_>>) -> Result<f64, FileError> {
        let text = match value.get_ref() {
            DeValue::Float(number) => number.as_str().to_owned(),
            DeValue::Integer(number) if number.radix() == 10 => number.as_str().to_owned(),
            other => {
                return Err(self.key(key, value.span().start, format!("must be a number, not {}", other.type_str())));
            }
        };
        match text.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            _ => Err(self.key(key, value.span().start, format!("is {text}, which is not a finite number"))),
        }
    }

    pub(crate) fn string(&self, key: &str, value: &Spanned<DeValue<'_>>) -> Result<String, FileError> {
        match value.get_ref() {
            DeValue::String(text) => Ok(text.to_string()),
            other => Err(self.key(key, value.span().start, format!("must be a string, not {}", other.type_str()))),
        }
    }

    pub(crate) fn known(&self, prefix: &str, table: &DeTable<'_>, known: &[&str]) -> Result<(), FileError> {
        for key in table.keys() {
            if !known.contains(&key.get_ref().as_ref()) {
                let name = format!("{prefix}{}", key.get_ref());
                return Err(self.key(
                    name,
                    key.span().start,
                    format!("is not a key here; the keys are {}", known.join(", ")),
                ));
            }
        }
        Ok(())
    }
}
