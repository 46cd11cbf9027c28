// The page: panels first, then the messages.

import { alarms } from "./alarms.js";
import { control } from "./controls.js";
import { curves } from "./curves.js";
import { broken, head } from "./head.js";
import { lists } from "./lists.js";
import { see } from "./see.js";
import { listen } from "./stream.js";
import { views } from "./views.js";

views();
head();
lists();
curves();
see();
alarms();
control();
listen(broken);
