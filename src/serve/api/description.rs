//! Makes the description whole: what every operation may answer beside what it says itself, so that a client made from it
//! knows each answer.

use super::super::problem::PROBLEM_JSON;
use utoipa::openapi::header::HeaderBuilder;
use utoipa::openapi::path::{Operation, ParameterBuilder, ParameterIn};
use utoipa::openapi::schema::{Object, ObjectBuilder, Ref, Type};
use utoipa::openapi::{Components, ContentBuilder, OpenApi, RefOr, Response, ResponseBuilder, Schema};

/// Gives every operation the problems that it may answer, and every problem its shape.
pub fn complete(mut api: OpenApi) -> OpenApi {
    let components = api.components.get_or_insert_with(Components::new);
    components.schemas.insert("Problem".to_string(), RefOr::T(Schema::Object(problem())));
    for (path, item) in &mut api.paths.paths {
        let operations = [&mut item.get, &mut item.post, &mut item.put, &mut item.delete, &mut item.patch];
        operations.into_iter().flatten().for_each(|own| {
            operation(own);
            body(own);
            name(own, path);
        });
    }
    api
}

/// Says of every GET that it may be asked for with the validator of an answer that the client still holds.
pub fn conditional(api: &mut OpenApi) {
    let text = || ObjectBuilder::new().schema_type(Type::String);
    for get in api.paths.paths.values_mut().filter_map(|item| item.get.as_mut()) {
        let asked = ParameterBuilder::new()
            .name("If-None-Match")
            .parameter_in(ParameterIn::Header)
            .description(Some("the ETag of an answer that the client still holds"))
            .schema(Some(text()));
        get.parameters.get_or_insert_default().push(RefOr::T(asked.build()));
        let responses = &mut get.responses.responses;
        if let Some(RefOr::T(whole)) = responses.get_mut("200") {
            let tag = HeaderBuilder::new().schema(Some(text())).description(Some("for If-None-Match"));
            whole.headers.insert("ETag".to_string(), tag.build().into());
        }
        let same = ResponseBuilder::new().description("the client's answer is still good").build();
        responses.insert("304".to_string(), RefOr::T(same));
    }
}

/// A name that no other operation has, of which clients make the names of functions.
fn name(operation: &mut Operation, path: &str) {
    let own = operation.operation_id.take().unwrap_or_default();
    let tag = operation.tags.iter().flatten().next().map(String::as_str).unwrap_or_default();
    let place = if path.starts_with("/api/") { "" } else { "_at_root" };
    operation.operation_id = Some(format!("{tag}_{own}{place}"));
}

/// A body that may be left out is described as left out, not as null: clients send what is described.
fn body(operation: &mut Operation) {
    let Some(RefOr::T(body)) = &mut operation.request_body else { return };
    for content in body.content.values_mut() {
        if let RefOr::T(content) = content
            && let Some(RefOr::T(Schema::OneOf(either))) = &content.schema
        {
            let own = either.items.iter().find(|item| matches!(item, RefOr::Ref(_))).cloned();
            content.schema = own.or(content.schema.take());
        }
    }
}

fn operation(operation: &mut Operation) {
    let responses = &mut operation.responses.responses;
    for (status, response) in responses.iter_mut() {
        // A description is required, and an empty one is left out of the text.
        if let RefOr::T(response) = response
            && response.description.is_empty()
        {
            response.description = "done".to_string();
        }
        let failed = status.starts_with(['4', '5']);
        if let RefOr::T(response) = response
            && failed
            && response.content.is_empty()
        {
            response.content = answer("").content;
        }
    }
    let rest =
        "problem: the request is wrong, may not be, is too large or too late, or there is too much at once";
    responses.insert("default".to_string(), RefOr::T(answer(rest)));
}

fn answer(description: &str) -> Response {
    let content = ContentBuilder::new().schema(Some(Ref::from_schema_name("Problem"))).build();
    ResponseBuilder::new().description(description).content(PROBLEM_JSON, content).build()
}

/// RFC 9457; members beside these say more.
fn problem() -> Object {
    let text = || ObjectBuilder::new().schema_type(Type::String);
    let members = ["type", "title", "status", "detail"];
    let object = ObjectBuilder::new()
        .schema_type(Type::Object)
        .description(Some("What went wrong, and what to do about it."))
        .property("type", text())
        .property("title", text())
        .property("status", ObjectBuilder::new().schema_type(Type::Integer))
        .property("detail", text());
    members.into_iter().fold(object, ObjectBuilder::required).build()
}
