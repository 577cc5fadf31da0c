//! Services that add, remove and list models while the simulation runs.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use ros_node::Announcement;

use super::messages::ambf_msgs::{
    AddModel, AddModelReq, AddModelRes, ListModels, ListModelsReq, ListModelsRes, RemoveModel, RemoveModelReq,
    RemoveModelRes,
};
use super::service::service_of;

/// The answer to a client about a model that was added.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ModelReply {
    /// What to call it when it is removed.
    pub model: String,
    /// Warnings, one a line; empty when there are none.
    pub message: String,
}

/// Adds and removes models of the simulation on behalf of clients.
///
/// Each client is served in a thread of its own, so that the functions are called from several at once; they may block,
/// but not for ever: the client waits. A call may still be going on when the middleware has stopped.
pub trait ModelHost: Send + Sync {
    /// Adds the model in `file`, as the client wrote it.
    ///
    /// # Errors
    /// One sentence for the client; the simulation is as before.
    fn add(&self, file: &Path) -> Result<ModelReply, String>;

    /// Removes the model called `model`; returns what the client should know about it, which may be nothing.
    ///
    /// # Errors
    /// One sentence for the client; the simulation is as before.
    fn remove(&self, model: &str) -> Result<String, String>;

    /// Name and file of each model, in the order in which they were added.
    fn list(&self) -> Vec<(String, PathBuf)>;
}

/// The services `add_model`, `remove_model` and `list_models`; `name` gives the full name of each.
pub(super) fn services(name: impl Fn(&str) -> String, host: &Arc<dyn ModelHost>) -> [Arc<dyn Announcement>; 3] {
    let (adder, remover, lister) = (Arc::clone(host), Arc::clone(host), Arc::clone(host));
    [
        service_of::<AddModel>(name("add_model"), move |request| add(&*adder, &request)),
        service_of::<RemoveModel>(name("remove_model"), move |request| remove(&*remover, &request)),
        service_of::<ListModels>(name("list_models"), move |request| list(&*lister, &request)),
    ]
}

pub(super) fn add(host: &dyn ModelHost, request: &AddModelReq) -> AddModelRes {
    match host.add(Path::new(&request.file)) {
        Ok(ModelReply { model, message }) => AddModelRes { success: true, model, message },
        Err(message) => AddModelRes { success: false, model: String::new(), message },
    }
}

pub(super) fn remove(host: &dyn ModelHost, request: &RemoveModelReq) -> RemoveModelRes {
    let (success, message) = match host.remove(&request.model) {
        Ok(message) => (true, message),
        Err(message) => (false, message),
    };
    RemoveModelRes { success, message }
}

pub(super) fn list(host: &dyn ModelHost, _: &ListModelsReq) -> ListModelsRes {
    let (models, files) =
        host.list().into_iter().map(|(name, file)| (name, file.to_string_lossy().into_owned())).unzip();
    ListModelsRes { models, files }
}
