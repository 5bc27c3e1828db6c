// Everything else that the file says of itself.
import { bytesText, element, percent, place, section, table } from './elements.js';

const SECTIONS = { 'RSH': 'light', VALD: 'which nodes are filled', COVR: 'coverage', SERR: 'noise', BIAS: 'systematic error', WERR: 'noise in the worst direction', CERR: 'noise of each coefficient', POSN: 'positions', NORM: 'normals', MESH: 'meshes', WALL: 'walls between nodes', BRIK: 'where nodes are', SETT: 'settings', PLAN: 'plan', PROB: 'probes', STAT: 'statistics' };

export function tables( report, probes ) {

	const { statistics, settings } = report;
	const made = [];
	if ( report.command ) made.push( section( 'Bake it again', element( 'p', {}, 'Names are without their folders. Places that a BAKE.toml gave to probes have to be given again.' ), element( 'pre', { tabIndex: 0 }, report.command ) ) );
	if ( statistics?.stages?.length ) made.push( section( 'Time by stage', stages( statistics ) ) );
	if ( report.plan ) made.push( section( 'Plan', table( [ 'stage', '', 'why' ], report.plan.map( ( { stage, kept, why } ) => [ stage, kept ? 'kept' : 'left out', why ] ) ) ) );
	if ( settings ) made.push( section( 'Settings that are not the usual ones', changed( report ) ) );
	if ( report.inputs?.length ) made.push( section( 'Inputs', table( [ 'what', 'file', 'bytes', 'BLAKE3' ], report.inputs.map( ( { role, name, bytes, blake3 } ) => [ role, name, bytesText( bytes ), element( 'code', {}, blake3.slice( 0, 16 ) ) ] ), { numbers: [ 2 ] } ) ) );
	if ( report.probes?.length ) made.push( section( 'Probes', probeList( report.probes, probes ) ) );
	made.push( section( 'Bytes', table( [ 'section', 'holds', 'bytes', 'per node', 'how' ], report.sections.map( ( { id, codec, stored_bytes: bytes } ) => [ id, SECTIONS[ id ] ?? '', bytesText( bytes ), ( bytes / report.volume.nodes ).toFixed( 2 ), codec ] ), { numbers: [ 2, 3 ] } ) ) );
	return made;

}

function stages( { stages, rays, samples } ) {

	const millions = ( n ) => `${ ( n / 1e6 ).toFixed( 1 ) } M`;
	const timed = stages.some( ( stage ) => stage.seconds );
	return element( 'div', {},
		table( [ 'stage', 'seconds', 'CPU seconds', 'rays' ], stages.map( ( stage ) => [ stage.stage, stage.seconds?.wall.toFixed( 2 ) ?? '–', stage.seconds?.cpu.toFixed( 2 ) ?? '–', millions( stage.rays ) ] ), { numbers: [ 1, 2, 3 ] } ),
		element( 'p', {}, `${ millions( rays ) } rays for ${ millions( samples ) } directions.`, timed ? '' : ' Times are in the file if it was baked with --record-times.' ) );

}

function changed( { settings, settings_changed: names } ) {

	const rows = names.map( ( name ) => [ name, String( settings[ name ] ) ] );
	return rows.length ? table( [ 'setting', 'value' ], rows ) : element( 'p', {}, 'All are as a bake without any flag takes them.' );

}

function probeList( all, pictures ) {

	return element( 'div.probes', {}, all.map( ( probe ) => element( 'figure', {},
		thumbnail( pictures.find( ( { name } ) => name === probe.name ) ),
		element( 'figcaption', {}, element( 'b', {}, probe.name ), ` ${ probe.size.join( ' × ' ) }, ${ probe.position ? `at ${ place( probe.position ) }` : 'at infinity' }${ probe.distance ? ', with distances' : '' }` ) ) ) );

}

function thumbnail( picture ) {

	if ( ! picture ) return null;
	const { name, width, height, bytes } = picture;
	const canvas = element( 'canvas', { width, height, 'aria-label': `Picture of ${ name }`, role: 'img' } );
	const image = new ImageData( width, height );
	for ( let k = 0; k < width * height; k ++ ) image.data.set( [ bytes[ 3 * k ], bytes[ 3 * k + 1 ], bytes[ 3 * k + 2 ], 255 ], 4 * k );
	canvas.getContext( '2d' ).putImageData( image, 0, 0 );
	return canvas;

}

/** Which volume this is, in a line. */
export function about( report ) {

	const { kind, grid, min, max, sh, precision, bytes, volume } = report;
	const size = max.map( ( x, k ) => ( x - min[ k ] ).toFixed( 1 ) ).join( ' × ' );
	const spacing = grid ? `, ${ Math.max( ...grid.spacing ).toFixed( 2 ) } m apart` : '';
	return `${ kind } of ${ volume.nodes.toLocaleString( 'en' ) } nodes${ spacing }, ${ size } m, ${ sh } in ${ precision }, ${ bytesText( bytes ) }; ${ percent( volume.nodes_valid / volume.nodes ) } of the nodes were baked`;

}
