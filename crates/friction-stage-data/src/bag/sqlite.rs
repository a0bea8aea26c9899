//! One sqlite3 file of rosbag2, any version of its tables.
//!
//! It is opened for reading only, in a way that writes no file beside it, and is read page by page
//! in the order of log time. Source of the tables: rosbag2_storage_sqlite3; `topics` and `messages`
//! are in every version, `schema`, `metadata`, `message_definitions` and some columns in later
//! ones. What is missing is taken as empty.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use rusqlite::config::DbConfig;
use rusqlite::limits::Limit;
use rusqlite::{Connection, ErrorCode, OpenFlags, OptionalExtension, Row, ffi, params};

use super::error::BagError;
use super::file::Damage;
use super::limits;
use super::metadata::Found;

/// Bytes of messages that are read at once, beyond the first of them.
const PAGE: usize = 4 * 1024 * 1024;
/// Most topics, as many as MCAP can tell apart.
const TOPICS: u32 = 1 << 16;
/// Messages that are read at once.
const PAGE_ROWS: usize = 4096;
/// Largest text or message, bytes.
const LARGEST: i32 = limits::CHUNK as i32;

/// A topic of the file.
#[derive(Debug, Clone, Default)]
pub(super) struct StoredTopic {
    pub id: i64,
    pub name: String,
    pub type_name: String,
    /// Encoding of the messages.
    pub encoding: String,
    pub qos: String,
    pub type_hash: String,
    /// Language and text of the definition; empty where there is none.
    pub definition: (String, String),
    pub messages: u64,
}

/// A message of the file.
pub(super) struct StoredMessage {
    pub topic: i64,
    /// ns
    pub time: i64,
    pub row: i64,
    pub data: Vec<u8>,
}

/// Up to where a file is read.
#[derive(Debug, Clone, Copy)]
pub(super) enum Position {
    /// In the order of time: after the message of this time and row.
    Time(i64, i64),
    /// The order of time is damaged: in the order of rows, after this one.
    Row(i64),
}

/// Messages, and where those after them begin; none at the end.
pub(super) struct Page {
    pub messages: Vec<StoredMessage>,
    pub next: Option<Position>,
    /// What could not be read after them.
    pub damage: Option<Damage>,
}

/// A sqlite3 file, looked at.
pub(super) struct Database {
    /// As people know it.
    pub path: PathBuf,
    /// Where it lies, unpacked.
    file: PathBuf,
    pub size: u64,
    pub topics: Vec<StoredTopic>,
    /// First and last log time, ns.
    pub range: Option<(i64, i64)>,
    /// What the file itself says, as `metadata.yaml` does.
    pub metadata: Option<Found>,
    pub damage: Vec<Damage>,
    /// Whether the rows are in the order of time; only looked at where nothing else gives it.
    are_rows_in_order: bool,
}

impl Database {
    /// Looks at the tables of `file`, which people know as `path`.
    pub fn open(path: &Path, file: &Path) -> Result<Self, BagError> {
        let bytes = std::fs::metadata(file).map_err(|e| BagError::reading(path, e))?;
        let mut database = Self {
            path: path.to_owned(),
            file: file.to_owned(),
            size: bytes.len(),
            topics: Vec::new(),
            range: None,
            metadata: None,
            damage: Vec::new(),
            are_rows_in_order: false,
        };
        database.damage.extend(database.missing_end()?);
        database.damage.extend(database.unfinished());
        let connection = database.connect().map_err(|error| database.broken(&error).error())?;
        if let Err(error) = database.read_tables(&connection) {
            return Err(match (error, database.damage.first()) {
                (_, Some(damage)) => damage.error(),
                (Ok(error), None) => database.broken(&error).error(),
                (Err(reason), None) => BagError::NotABag { path: path.to_owned(), reason },
            });
        }
        if let Err(error) = database.count(&connection) {
            let damage = database.broken(&error);
            database.damage.push(damage);
            database.count_by_rows(&connection);
        }
        Ok(database)
    }

    /// A connection that reads the file and writes none.
    pub fn connect(&self) -> rusqlite::Result<Connection> {
        let absolute = std::path::absolute(&self.file).unwrap_or_else(|_| self.file.clone());
        let mut address = String::from("file://");
        for byte in absolute.as_os_str().as_bytes() {
            match byte {
                b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'/' | b'.' | b'_' | b'-' => {
                    address.push(char::from(*byte));
                }
                byte => {
                    let _ = write!(address, "%{byte:02x}");
                }
            }
        }
        // A file that nothing writes needs no locks. Messages that are still in the log of a
        // recorder that was killed are read from there, the index over the log being kept in
        // memory.
        let has_log = self.has_beside("-wal");
        address += if has_log { "?mode=ro&vfs=unix-none" } else { "?mode=ro&immutable=1" };
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY
            | OpenFlags::SQLITE_OPEN_URI
            | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let connection = Connection::open_with_flags(address, flags)?;
        connection.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, true)?;
        connection.set_db_config(DbConfig::SQLITE_DBCONFIG_TRUSTED_SCHEMA, false)?;
        connection.set_limit(Limit::SQLITE_LIMIT_LENGTH, LARGEST)?;
        if has_log {
            connection.pragma_update(None, "locking_mode", "exclusive")?;
        }
        connection.pragma_update(None, "cell_size_check", true)?;
        if self.damage.iter().any(|damage| damage.offset > 0) {
            // Reads what a file that was cut off still has.
            connection.pragma_update(None, "writable_schema", true)?;
        }
        Ok(connection)
    }

    fn has_beside(&self, ending: &str) -> bool {
        let mut name = self.file.as_os_str().to_owned();
        name.push(ending);
        std::fs::metadata(name).is_ok_and(|found| found.is_file() && found.len() > 0)
    }

    /// Whether the file is shorter than it says.
    fn missing_end(&self) -> Result<Option<Damage>, BagError> {
        use std::os::unix::fs::FileExt;
        let mut header = [0; 100];
        let file = std::fs::File::open(&self.file).map_err(|e| BagError::reading(&self.path, e))?;
        if file.read_exact_at(&mut header, 0).is_err() {
            return Ok(Some(self.cut_off(100)));
        }
        let number = |at: usize| u32::from_be_bytes([0, 1, 2, 3].map(|k| header[at + k]));
        let page = match u16::from_be_bytes([header[16], header[17]]) {
            1 => 65536,
            size => u64::from(size),
        };
        // The count holds where the version of who wrote it last stands beside it.
        let is_counted = number(24) == number(92);
        let whole = page * u64::from(number(28));
        Ok((is_counted && whole > self.size).then(|| self.cut_off(whole)))
    }

    fn cut_off(&self, whole: u64) -> Damage {
        Damage {
            path: self.path.clone(),
            offset: self.size,
            bytes: whole - self.size,
            expected: format!("a database of {whole} bytes"),
            found: "the end of the file".into(),
        }
    }

    /// A recorder that was killed leaves a journal of what it was about to change.
    fn unfinished(&self) -> Option<Damage> {
        self.has_beside("-journal").then(|| Damage {
            path: self.path.clone(),
            offset: 0,
            bytes: 0,
            expected: "a recording that was closed".into(),
            found: "a file -journal of a write that did not end".into(),
        })
    }

    /// An error of the database in words of a recording.
    pub fn broken(&self, error: &rusqlite::Error) -> Damage {
        let found = match error.sqlite_error_code() {
            Some(ErrorCode::NotADatabase) => "a header of none",
            Some(ErrorCode::DatabaseCorrupt) => "pages that contradict each other",
            Some(ErrorCode::SystemIoFailure) => "pages that cannot be read",
            Some(ErrorCode::TooBig) => "a message of more than 128 MiB",
            _ => "tables with other values than rosbag2 writes",
        };
        Damage {
            path: self.path.clone(),
            offset: 0,
            bytes: 0,
            expected: "a database of rosbag2".into(),
            found: found.into(),
        }
    }

    /// The inner error says which table or column is missing.
    fn read_tables(
        &mut self,
        connection: &Connection,
    ) -> Result<(), Result<rusqlite::Error, String>> {
        let columns = |table: &str| columns(connection, table).map_err(Ok);
        let topics = columns("topics")?;
        let messages = columns("messages")?;
        let needed = [
            ("topics", &topics, &["id", "name", "type"][..]),
            ("messages", &messages, &["topic_id", "timestamp", "data"]),
        ];
        for (table, found, names) in needed {
            if let Some(name) = names.iter().find(|name| !found.iter().any(|f| f == *name)) {
                return Err(Err(format!(
                    "it is a database without the column `{name}` of a table `{table}`, which \
                     every bag of rosbag2 has"
                )));
            }
        }
        let optional = |name: &str| {
            if topics.iter().any(|found| found == name) { name.to_owned() } else { "''".into() }
        };
        let query = format!(
            "SELECT id, name, type, {}, {}, {} FROM topics ORDER BY id LIMIT {TOPICS}",
            optional("serialization_format"),
            optional("offered_qos_profiles"),
            optional("type_description_hash")
        );
        self.topics = rows(connection, &query, |row| {
            Ok(StoredTopic {
                id: row.get(0)?,
                name: row.get(1)?,
                type_name: row.get(2)?,
                encoding: row.get::<_, Option<String>>(3)?.unwrap_or_default(),
                qos: row.get::<_, Option<String>>(4)?.unwrap_or_default(),
                type_hash: row.get::<_, Option<String>>(5)?.unwrap_or_default(),
                ..StoredTopic::default()
            })
        })
        .map_err(Ok)?;
        let defined = columns("message_definitions")?;
        if ["topic_type", "encoding", "encoded_message_definition"]
            .iter()
            .all(|name| defined.iter().any(|found| found == name))
        {
            let query =
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions";
            let definitions: BTreeMap<String, (String, String)> =
                rows(connection, query, |row| Ok((row.get(0)?, (row.get(1)?, row.get(2)?))))
                    .map_err(Ok)?
                    .into_iter()
                    .collect();
            let mut room = limits::DEFINITIONS;
            for topic in &mut self.topics {
                if let Some(definition) = definitions.get(&topic.type_name) {
                    room = room.saturating_sub(definition.1.len() as u64);
                    if room == 0 {
                        return Err(Err(format!(
                            "the definitions of its topics have more than {} bytes",
                            limits::DEFINITIONS
                        )));
                    }
                    topic.definition = definition.clone();
                }
            }
        }
        if columns("metadata")?.iter().any(|found| found == "metadata") {
            let query = "SELECT metadata FROM metadata ORDER BY rowid DESC LIMIT 1";
            let text = connection.query_row(query, [], |row| row.get::<_, String>(0)).optional();
            self.metadata = text.map_err(Ok)?.and_then(|text| Found::of_information(&text));
        }
        Ok(())
    }

    fn count(&mut self, connection: &Connection) -> rusqlite::Result<()> {
        let query = "SELECT topic_id, COUNT(*), MIN(timestamp), MAX(timestamp) FROM messages \
                     GROUP BY topic_id";
        let counts: Vec<(i64, i64, i64, i64)> = rows(connection, query, |row| {
            Ok((row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?))
        })?;
        for (id, messages, first, last) in counts {
            self.note(id, messages.unsigned_abs(), first, last);
        }
        if !has_index(connection)? {
            let mut statement =
                connection.prepare("SELECT timestamp FROM messages ORDER BY rowid")?;
            let mut rows = statement.query([])?;
            let mut last = i64::MIN;
            self.are_rows_in_order = true;
            while let Some(row) = rows.next()? {
                let time: i64 = row.get(0)?;
                if time < last {
                    self.are_rows_in_order = false;
                    break;
                }
                last = time;
            }
        }
        Ok(())
    }

    fn note(&mut self, id: i64, messages: u64, first: i64, last: i64) {
        let (begin, end) = self.range.unwrap_or((first, last));
        self.range = Some((begin.min(first), end.max(last)));
        // They are in the order of their numbers.
        match self.topics.binary_search_by_key(&id, |topic| topic.id) {
            Ok(place) => self.topics[place].messages += messages,
            Err(_) => {
                let damage = Damage {
                    path: self.path.clone(),
                    offset: 0,
                    bytes: 0,
                    expected: "messages of topics that the file lists".into(),
                    found: format!("{messages} of a topic with the number {id}"),
                };
                self.damage.push(damage);
            }
        }
    }

    /// Counts what can be read of a damaged file.
    fn count_by_rows(&mut self, connection: &Connection) {
        self.range = None;
        self.topics.iter_mut().for_each(|topic| topic.messages = 0);
        let mut position = Some(Position::Row(i64::MIN));
        while let Some(from) = position {
            let page = self.page(connection, from);
            for message in &page.messages {
                if self.topics.binary_search_by_key(&message.topic, |topic| topic.id).is_ok() {
                    self.note(message.topic, 1, message.time, message.time);
                }
            }
            position = page.next;
        }
    }

    /// Where reading begins.
    pub fn begin(&self) -> Position {
        let is_ordered = self.damage.iter().all(|damage| damage.found.starts_with("a file -"));
        let is_ordered = is_ordered && !self.are_rows_in_order;
        if is_ordered { Position::Time(i64::MIN, i64::MIN) } else { Position::Row(i64::MIN) }
    }

    /// The messages after `from`, as many as fit a page. Where the order of time is damaged, what
    /// follows comes in the order of rows.
    pub fn page(&self, connection: &Connection, from: Position) -> Page {
        let mut messages = Vec::new();
        let read = match from {
            Position::Time(..) => self.rows_after(
                connection,
                "SELECT rowid, topic_id, timestamp, data FROM messages \
                 WHERE timestamp >= ?1 AND (timestamp > ?1 OR rowid > ?2) \
                 ORDER BY timestamp, rowid",
                from,
                &mut messages,
            ),
            Position::Row(_) => self.rows_after(
                connection,
                "SELECT rowid, topic_id, timestamp, data FROM messages \
                 WHERE rowid > ?2 AND ?1 = ?1 ORDER BY rowid",
                from,
                &mut messages,
            ),
        };
        let last = messages.last().map(|message: &StoredMessage| (message.time, message.row));
        match (read, from) {
            (Ok(false), _) => Page { messages, next: None, damage: None },
            (Ok(true), Position::Time(..)) => {
                Page { messages, next: last.map(|(t, r)| Position::Time(t, r)), damage: None }
            }
            (Ok(true), Position::Row(_)) => {
                Page { messages, next: last.map(|(_, row)| Position::Row(row)), damage: None }
            }
            (Err(error), from) => {
                let next = match (from, last) {
                    (Position::Time(..), Some((time, row))) => {
                        self.after_row(connection, time, row)
                    }
                    (Position::Time(time, row), None) => self.after_row(connection, time, row),
                    (Position::Row(_), Some((_, row))) | (Position::Row(row), None) => {
                        self.after_hole(connection, row)
                    }
                };
                Page { messages, next, damage: Some(self.broken(&error)) }
            }
        }
    }

    /// The place after the message that follows the one of this time and row, which cannot be
    /// read. The index alone tells it; where that is damaged, too, the order of rows has to do.
    fn after_row(&self, connection: &Connection, time: i64, row: i64) -> Option<Position> {
        let query = "SELECT timestamp, rowid FROM messages \
                     WHERE timestamp >= ?1 AND (timestamp > ?1 OR rowid > ?2) \
                     ORDER BY timestamp, rowid LIMIT 1";
        let next = connection
            .query_row(query, params![time, row], |found| Ok((found.get(0)?, found.get(1)?)))
            .optional();
        match next {
            Ok(Some(next)) if next > (time, row) => Some(Position::Time(next.0, next.1)),
            Ok(None) => None,
            _ => self.after_hole(connection, row),
        }
    }

    /// Where messages can be read again after a place that cannot, in the order of rows: twice as
    /// far on with every try.
    fn after_hole(&self, connection: &Connection, row: i64) -> Option<Position> {
        let query = "SELECT rowid FROM messages WHERE rowid > ?1 ORDER BY rowid LIMIT 1";
        let first = row.max(0);
        for power in 0..62 {
            let from = first.checked_add(1 << power)?;
            let found = connection
                .query_row(query, params![from], |found| found.get::<_, i64>(0))
                .optional();
            match found {
                Ok(Some(found)) if found > from => return Some(Position::Row(found - 1)),
                Ok(None) => return None,
                _ => {}
            }
        }
        None
    }

    /// Reads rows until a page is full; whether there may be more.
    fn rows_after(
        &self,
        connection: &Connection,
        query: &str,
        from: Position,
        messages: &mut Vec<StoredMessage>,
    ) -> rusqlite::Result<bool> {
        let mut statement = connection.prepare(query)?;
        let mut rows = statement.query(match from {
            Position::Time(time, row) => [time, row],
            Position::Row(row) => [0, row],
        })?;
        let mut bytes = 0;
        let mut last = match from {
            Position::Time(time, row) => (time, row),
            Position::Row(row) => (0, row),
        };
        while let Some(row) = rows.next()? {
            let (number, time) = (row.get(0)?, row.get(2)?);
            let place = match from {
                Position::Time(..) => (time, number),
                Position::Row(_) => (0, number),
            };
            if place <= last {
                // A damaged page leads back, for ever.
                return Err(rusqlite::Error::SqliteFailure(
                    ffi::Error::new(ffi::SQLITE_CORRUPT),
                    None,
                ));
            }
            last = place;
            let data = row.get_ref(3)?;
            let data = data.as_bytes_or_null().map_err(rusqlite::Error::from)?.unwrap_or_default();
            bytes += data.len();
            messages.push(StoredMessage {
                row: number,
                topic: row.get(1)?,
                time,
                data: data.to_vec(),
            });
            if bytes >= PAGE || messages.len() >= PAGE_ROWS {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Whether the pages of the file hold together; reads all of them.
    pub fn verify(&self) -> Option<Damage> {
        let check = |connection: Connection| {
            connection.query_row("PRAGMA quick_check(1)", [], |row| row.get::<_, String>(0))
        };
        match self.connect().and_then(check) {
            Ok(found) if found == "ok" => None,
            Ok(_) => Some(Damage {
                found: "pages that contradict each other".into(),
                ..self.broken(&rusqlite::Error::InvalidQuery)
            }),
            Err(error) => Some(self.broken(&error)),
        }
    }
}

/// Whether the file has the index over time that rosbag2 makes; without it every page is sorted
/// again.
fn has_index(connection: &Connection) -> rusqlite::Result<bool> {
    let query = "SELECT EXISTS (SELECT 1 FROM pragma_index_list('messages') AS list, \
                 pragma_index_info(list.name) AS info \
                 WHERE info.seqno = 0 AND info.name = 'timestamp')";
    connection.query_row(query, [], |row| row.get(0))
}

/// Names of the columns of a table; none where there is no such table.
/// Columns of a table that has rows of its own: views, and tables of modules, could compute without
/// end.
fn columns(connection: &Connection, table: &str) -> rusqlite::Result<Vec<String>> {
    let query = "SELECT name FROM pragma_table_info(?1) WHERE EXISTS \
                 (SELECT 1 FROM sqlite_master \
                 WHERE type = 'table' AND name = ?1 AND rootpage > 0)";
    let mut statement = connection.prepare(query)?;
    statement.query_map([table], |row| row.get(0))?.collect()
}

fn rows<T>(
    connection: &Connection,
    query: &str,
    of: impl FnMut(&Row<'_>) -> rusqlite::Result<T>,
) -> rusqlite::Result<Vec<T>> {
    connection.prepare(query)?.query_map([], of)?.collect()
}
