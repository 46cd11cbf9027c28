// Region of interest and masks on a test frame. Coordinates are px of the frame; the overlay has the same.
const token = location.hash.slice(1);
const headers = {authorization: `Bearer ${token}`};
const at = (id) => document.getElementById(id);
const overlay = at("overlay");
const state = {width: 0, height: 0, half: 0, region: [0, 0, 0, 0], masks: [], polygon: null, start: null};
const REGION_INPUTS = ["x0", "y0", "x1", "y1"];
const MASK_INPUTS = ["mx0", "my0", "mx1", "my1"];

const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
const tool = () => document.querySelector("[name=tool]:checked").value;

/** Rectangle with ordered corners inside the frame, rounded to px. */
function ordered([ax, ay, bx, by]) {
    const x = [ax, bx].map((value) => clamp(Math.round(value), 0, state.width - 1)).sort((a, b) => a - b);
    const y = [ay, by].map((value) => clamp(Math.round(value), 0, state.height - 1)).sort((a, b) => a - b);
    return [x[0], y[0], x[1], y[1]];
}

/** Region whose subsets lie inside the frame. */
function fitting(rectangle) {
    const [x0, y0, x1, y1] = ordered(rectangle);
    const [right, below] = [state.width - 1 - state.half, state.height - 1 - state.half];
    return [clamp(x0, state.half, right), clamp(y0, state.half, below), clamp(x1, state.half, right), clamp(y1, state.half, below)];
}

const corners = ([x0, y0, x1, y1]) => [[x0, y0], [x1, y0], [x1, y1], [x0, y1]];

function shape(kind, attributes, name) {
    const drawn = document.createElementNS("http://www.w3.org/2000/svg", kind);
    for (const [key, value] of Object.entries({...attributes, class: name})) drawn.setAttribute(key, value);
    return drawn;
}

const rectangleShape = ([x0, y0, x1, y1], name) => shape("rect", {x: x0, y: y0, width: x1 - x0, height: y1 - y0}, name);
const polygonShape = (points) => shape("polygon", {points: points.map((point) => point.join(",")).join(" ")}, "mask");

function draw() {
    const [x0, y0, x1, y1] = state.region;
    const pending = state.polygon ? [polygonShape(state.polygon)] : [];
    overlay.replaceChildren(
        ...state.masks.map(polygonShape), ...pending, rectangleShape(state.region, "region"),
        rectangleShape([x0 - state.half, y0 - state.half, x1 + state.half, y1 + state.half], "subsets"),
    );
    REGION_INPUTS.forEach((id, index) => { at(id).value = state.region[index]; });
    at("masks").replaceChildren(...state.masks.map((mask, index) => {
        const entry = document.createElement("li");
        const remove = document.createElement("button");
        remove.type = "button";
        remove.textContent = "Remove";
        remove.setAttribute("aria-label", `Remove mask ${index + 1}`);
        remove.addEventListener("click", () => { state.masks.splice(index, 1); draw(); });
        entry.append(`${mask.length} corners from ${mask[0].map(Math.round).join(", ")} px `, remove);
        return entry;
    }));
}

/** Position of a pointer in px of the frame. */
function position(event) {
    const box = overlay.getBoundingClientRect();
    const x = ((event.clientX - box.left) / box.width) * state.width;
    const y = ((event.clientY - box.top) / box.height) * state.height;
    return [clamp(x, 0, state.width - 1), clamp(y, 0, state.height - 1)];
}

function closePolygon() {
    if (state.polygon && state.polygon.length >= 3) state.masks.push(state.polygon);
    state.polygon = null;
    draw();
}

overlay.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    const point = position(event);
    if (tool() === "polygon") {
        state.polygon = [...(state.polygon ?? []), point.map(Math.round)];
        draw();
        return;
    }
    overlay.setPointerCapture(event.pointerId);
    state.start = point;
    if (tool() === "rectangle") state.masks.push(corners([...point, ...point]));
});

overlay.addEventListener("pointermove", (event) => {
    if (!state.start) return;
    const rectangle = [...state.start, ...position(event)];
    if (tool() === "region") state.region = fitting(rectangle);
    else state.masks[state.masks.length - 1] = corners(ordered(rectangle));
    draw();
});

overlay.addEventListener("pointerup", () => {
    const last = state.masks.at(-1);
    if (state.start && tool() === "rectangle" && (last[0][0] === last[2][0] || last[0][1] === last[2][1])) state.masks.pop();
    state.start = null;
    draw();
});

overlay.addEventListener("dblclick", () => {
    if (!state.polygon) return;
    state.polygon = state.polygon.filter((point, index, all) => index === 0 || point.some((value, axis) => value !== all[index - 1][axis]));
    closePolygon();
});

addEventListener("keydown", (event) => {
    if (!state.polygon) return;
    if (event.key === "Enter") {
        event.preventDefault();
        closePolygon();
    } else if (event.key === "Escape") {
        state.polygon = null;
        draw();
    }
});

for (const id of REGION_INPUTS) {
    at(id).addEventListener("change", () => {
        state.region = fitting(REGION_INPUTS.map((name) => Number(at(name).value)));
        draw();
    });
}

at("add").addEventListener("click", () => {
    const [x0, y0, x1, y1] = ordered(MASK_INPUTS.map((name) => Number(at(name).value)));
    if (x0 === x1 || y0 === y1) {
        at("message").textContent = "Give two corners of the mask: x0, y0, x1, y1.";
        return;
    }
    state.masks.push(corners([x0, y0, x1, y1]));
    draw();
});

async function answer(path, body) {
    const reply = await fetch(path, {method: "POST", headers, body});
    if (!reply.ok) {
        at("message").textContent = await reply.text();
        return;
    }
    at("message").textContent = "Taken. You can close this page; the questions continue in the terminal.";
    for (const control of document.querySelectorAll("button, input")) control.disabled = true;
}

at("form").addEventListener("submit", (event) => {
    event.preventDefault();
    closePolygon();
    answer("/drawing", JSON.stringify({region_px: state.region, masks_px: state.masks}));
});
at("keep").addEventListener("click", () => answer("/keep", ""));

try {
    const described = await fetch("/frame.json", {headers});
    if (!described.ok) throw new Error(await described.text());
    const {width, height, subset, region} = await described.json();
    Object.assign(state, {width, height, half: Math.floor(subset / 2), region});
    overlay.setAttribute("viewBox", `0 0 ${width} ${height}`);
    overlay.setAttribute("preserveAspectRatio", "none");
    at("image").src = URL.createObjectURL(await (await fetch("/frame.png", {headers})).blob());
    draw();
} catch (error) {
    at("message").textContent = `The frame cannot be shown: ${error.message}. Open the address that semlive init printed.`;
}
